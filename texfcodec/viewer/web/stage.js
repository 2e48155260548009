// What stands on the GPU: one or two assets, the pictures of both from one camera, and what of them is on the canvas.

import { Asset, Painter } from './draw.js';
import { DeviceError, Target } from './gl.js';
import { Presenter, psnrOf } from './present.js';

const STRIP = 100; // milliseconds of drawing between two looks at what the user does
const FEW = 1 / 4; // scale from which on a picture has few pixels for its vertices
const APART = 3; // radii of one that hold all of the other
const MOST_STRIPS = 16;
const DOUBLES = 1.5; // a strip that took less than so many times the last was not dear for its pixels

export class Stage {
  constructor(gl) {
    Object.assign(this, { gl, slots: [null, null], pictures: new Map(), serial: 0 });
    this.painter = new Painter(gl);
    this.presenter = new Presenter(gl);
  }

  /** Puts an asset, or nothing for null, into slot 0 or 1. Throws, and leaves it empty, where the device has no room. */
  load(slot, header) {
    if (this.slots[slot]) freeAll(this.gl, this.slots[slot].asset);
    this.slots[slot] = null;
    if (header?.payload) delete header.payload.uploaded; // which may be of another context
    if (!header) return;
    const asset = new Asset(this.gl, header);
    if (this.gl.getError() === this.gl.OUT_OF_MEMORY) throw new DeviceError('The device has no memory left for it.');
    this.slots[slot] = { asset, serial: ++this.serial };
  }

  /** Numbers of the slots that hold something. */
  get filled() {
    return [0, 1].filter((slot) => this.slots[slot]);
  }

  get assets() {
    return this.filled.map((slot) => this.slots[slot].asset);
  }

  /** Whether there are two that are no versions of one thing: they stand elsewhere, or in other units. */
  get apart() {
    const [first, second] = this.assets;
    return Boolean(second) && Math.max(first.reachIn(second.header), second.reachIn(first.header)) > APART;
  }

  /** The header whose centre and radius the camera of an asset's picture is in: the first's, where both stand in one place. */
  homeOf(asset) {
    return this.apart ? asset.header : this.assets[0].header;
  }

  /** Slots that a mode shows, of those that hold something. */
  shownIn(mode) {
    if (this.filled.length < 2) return this.filled;
    return { single: [0], other: [1] }[mode] ?? [0, 1];
  }

  /** What a picture of a slot has to be: its size, its camera, and a key that tells whether one is that already. */
  wish(slot, orbit, size, look, scale) {
    const wide = look.mode === 'side' && this.filled.length > 1 ? size[0] >> 1 : size[0];
    const [width, height] = [wide, size[1]].map((length) => Math.max(1, Math.round(length * scale)));
    const { serial, asset } = this.slots[slot], home = this.homeOf(asset);
    const reach = Math.max(...(this.apart ? [asset] : this.assets).map((one) => one.reachIn(home)));
    const camera = orbit.camera(width, height, reach);
    const options = { lit: look.lit, layer: look.layerOf(asset.header), effects: look.effects, without: [...look.without] };
    options.atOnce = scale <= FEW; // where vertices cost more than what hidden fragments ask
    const key = JSON.stringify([serial, asset.placeIn(home), camera, options]);
    return { asset, slot, home, camera, options, width, height, key };
  }

  /** The Target of a wish, and the key of what was last drawn into it. */
  target({ slot, width, height }) {
    const name = `${slot} ${width} ${height}`;
    if (!this.pictures.has(name)) this.pictures.set(name, { target: new Target(this.gl, width, height), key: '' });
    return this.pictures.get(name);
  }

  /** Whether the picture of a wish is there. */
  stands(wish) {
    return this.pictures.get(`${wish.slot} ${wish.width} ${wish.height}`)?.key === wish.key;
  }

  /** Programs that have been compiled. */
  get programs() {
    return this.assets.reduce((sum, asset) => sum + asset.programs.size, 0);
  }

  /** Frees all pictures: the canvas or the mode has another size. */
  forget() {
    this.pictures.forEach(({ target }) => target.free());
    this.pictures.clear();
  }

  /** Draws a wish, where it does not stand already, between rows of its picture; the milliseconds that took, or 0. */
  draw(wish, first = 0, rows = wish.height) {
    const { gl } = this, picture = this.target(wish), begin = performance.now();
    if (picture.key === wish.key) return 0;
    const isWhole = rows === wish.height;
    picture.key = '';
    if (!isWhole) gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, first, wish.width, rows);
    try {
      this.painter.draw(wish.asset, wish.camera, picture.target, wish.options, wish.home);
    } finally {
      gl.disable(gl.SCISSOR_TEST);
    }
    waitFor(gl, picture.target);
    if (isWhole) picture.key = wish.key;
    return performance.now() - begin;
  }

  /**
   * Draws a wish from above to below, strip after strip; yields the milliseconds of each. pace: what frames may take.
   * Every strip goes through all vertices, so that strips grow where that is what costs.
   */
  *drawn(wish, { full, least }) {
    const picture = this.target(wish), strips = Math.min(MOST_STRIPS, Math.max(1, Math.ceil(full / Math.max(STRIP, least))));
    if (picture.key === wish.key) return;
    let rows = Math.ceil(wish.height / strips), last = 0;
    for (let top = wish.height; top > 0;) {
      const first = Math.max(0, top - rows), milliseconds = this.draw(wish, first, top - first);
      yield milliseconds;
      top = first;
      if (milliseconds < DOUBLES * last) rows *= 2;
      else if (milliseconds > 2 * STRIP) rows = Math.ceil(rows / 2);
      last = milliseconds;
    }
    picture.key = wish.key;
  }

  /** Puts the pictures of wishes, in the order of their slots, on the canvas. */
  present(wishes, look, [width, height]) {
    const { gl } = this, targets = wishes.map((wish) => this.target(wish).target);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const mode = targets.length > 1 ? look.mode : 'single';
    this.presenter.show(targets[0], targets[1], { ...look, mode, width, height });
  }

  /** Shows nothing but the background. */
  clear([width, height], { background }) {
    const { gl } = this, nothing = new Target(gl, 1, 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.presenter.show(nothing, null, { width, height, mode: 'single', background });
    nothing.free();
  }

  /** How far the pictures of two wishes are apart: of psnrOf(), over white where the background has two colours. */
  compare(wishes, background) {
    const [first, second] = wishes.map((wish) => this.target(wish).target.read());
    return Array.isArray(background[0]) ? psnrOf(first, second) : psnrOf(first, second, background);
  }
}

/** Waits until all is drawn: a pixel that is read back cannot come earlier. */
function waitFor(gl, target) {
  target.bind();
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
}

/** Deletes what an object holds of the GPU, however deep: textures, buffers and vertex arrays. */
function freeAll(gl, node, seen = new Set()) {
  if (node instanceof WebGLTexture) gl.deleteTexture(node);
  else if (node instanceof WebGLBuffer) gl.deleteBuffer(node);
  else if (node instanceof WebGLVertexArrayObject) gl.deleteVertexArray(node);
  else if (node instanceof WebGLProgram) gl.deleteProgram(node);
  if (node === null || typeof node !== 'object' || ArrayBuffer.isView(node) || node === gl || seen.has(node)) return;
  seen.add(node);
  (node instanceof Map ? [...node.values()] : Object.values(node)).forEach((one) => freeAll(gl, one, seen));
}
