// What stands on the GPU: one or two assets, the pictures of both from one camera, and what of them is on the canvas.

import { Asset, Painter } from './draw.js';
import { Target } from './gl.js';
import { Presenter, psnrOf } from './present.js';

const STRIP = 60; // milliseconds of drawing between two looks at what the user does
const MOST_STRIPS = 16; // every strip goes through all vertices again

export class Stage {
  constructor(gl) {
    Object.assign(this, { gl, slots: [null, null], pictures: new Map(), serial: 0 });
    this.painter = new Painter(gl);
    this.presenter = new Presenter(gl);
  }

  /** Puts an asset, or nothing for null, into slot 0 or 1. Throws a DeviceError, and leaves the slot empty, where it is too large. */
  load(slot, header) {
    if (this.slots[slot]) freeAll(this.gl, this.slots[slot].asset);
    this.slots[slot] = null;
    if (header?.payload) delete header.payload.uploaded; // which may be of another context
    if (header) this.slots[slot] = { asset: new Asset(this.gl, header), serial: ++this.serial };
  }

  /** Numbers of the slots that hold something. */
  get filled() {
    return [0, 1].filter((slot) => this.slots[slot]);
  }

  get assets() {
    return this.filled.map((slot) => this.slots[slot].asset);
  }

  /** The header whose centre and radius the camera is in. */
  get home() {
    return this.assets[0].header;
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
    const reach = Math.max(...this.assets.map((asset) => asset.reachIn(this.home)));
    const camera = orbit.camera(width, height, reach), { serial, asset } = this.slots[slot];
    const options = { lit: look.lit, layer: look.layerOf(asset.header), effects: look.effects, without: [...look.without] };
    return { asset, slot, camera, options, width, height, key: JSON.stringify([serial, this.slots[this.filled[0]].serial, camera, options]) };
  }

  /** The Target of a wish, and the key of what was last drawn into it. */
  target({ slot, width, height }) {
    const name = `${slot} ${width} ${height}`;
    if (!this.pictures.has(name)) this.pictures.set(name, { target: new Target(this.gl, width, height), key: '' });
    return this.pictures.get(name);
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
      this.painter.draw(wish.asset, wish.camera, picture.target, wish.options, this.home);
    } finally {
      gl.disable(gl.SCISSOR_TEST);
    }
    waitFor(gl, picture.target);
    if (isWhole) picture.key = wish.key;
    return performance.now() - begin;
  }

  /** Draws a wish from above to below, strip after strip; yields the milliseconds of each. */
  *drawn(wish, expected) {
    const picture = this.target(wish), strips = Math.min(MOST_STRIPS, Math.max(1, Math.ceil(expected / STRIP)));
    if (picture.key === wish.key) return;
    const step = Math.ceil(wish.height / strips);
    for (let top = wish.height; top > 0; top -= step) {
      const first = Math.max(0, top - step);
      yield this.draw(wish, first, top - first);
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
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background.map((v) => v / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** How far the pictures of two wishes are apart: of psnrOf(). */
  compare(wishes, background) {
    const [first, second] = wishes.map((wish) => this.target(wish).target.read());
    return psnrOf(first, second, background);
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
