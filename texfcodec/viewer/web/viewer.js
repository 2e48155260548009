// The page as a person uses it.

import { anglesOf, distanceAround, Orbit, VIEWS } from './camera.js';
import { Captions } from './captions.js';
import { Controls } from './controls.js';
import { listenToDrops } from './drop.js';
import { rendererOf } from './jobs.js';
import { helpBox, listenToKeys } from './keys.js';
import { Look } from './look.js';
import { mention, say } from './message.js';
import { Pace } from './pace.js';
import { Panel } from './panel.js';
import { backgroundStyle } from './present.js';
import { Stage } from './stage.js';

const REST = 180; // milliseconds without a change after which the picture is drawn in full
const MOST_DENSE = 2; // pixels of the canvas to one of the page
const FOV = 40; // degrees, where nothing else is said
const TOLD_EVERY = 250; // milliseconds between two figures of the frame time while it moves
const CAMERA = 'camera=';

export class Viewer {
  /** headers: of one or two assets; source: where they come from, and what the page is told of itself. */
  constructor(canvas, gl, headers, source) {
    const { about } = source;
    Object.assign(this, { canvas, gl, source, about, headers: [headers[0] ?? null, headers[1] ?? null], problems: ['', ''] });
    Object.assign(this, { pace: new Pace(), isSettled: false, touched: 0, toldAt: 0, compared: '' });
    canvas.viewer = this; // for a browser's console, and for tests
    this.look = new Look(about.start, location.search);
    this.look.lightFor(this.headers[0]);
    this.fov = about.start?.camera?.perspective || FOV;
    this.uploadAll();
    this.fit();
    this.orbit = this.firstCamera();
    this.captions = new Captions(canvas);
    this.panel = new Panel(this, about.version);
    this.helper = helpBox();
    document.body.append(this.captions.root, this.panel.root, this.helper);
    this.listen();
    this.retitle();
    this.settleMode();
    this.touch();
  }

  listen() {
    const { canvas } = this;
    new Controls(canvas, this);
    listenToKeys(this);
    listenToDrops(this);
    new ResizeObserver(() => this.touch()).observe(canvas);
    addEventListener('hashchange', () => this.readHash() && this.moved());
    canvas.addEventListener('webglcontextlost', (event) => this.lose(event));
    canvas.addEventListener('webglcontextrestored', () => this.restore());
  }

  // Assets

  uploadAll() {
    this.stage = new Stage(this.gl);
    this.headers.forEach((_, slot) => this.upload(slot));
  }

  upload(slot) {
    const header = this.headers[slot];
    this.problems[slot] = '';
    try {
      this.stage.load(slot, header);
    } catch (error) {
      this.problems[slot] = `${header.name} cannot be shown. ${error.message}`;
      say(this.problems[slot]);
    }
  }

  bytesOnGpu(slot) {
    return this.stage?.slots[slot]?.asset.bytes ?? null;
  }

  /** Shows an unpacked header in slot 0 or 1, in place of what is there. */
  show(header, slot) {
    this.headers[slot] = header;
    this.upload(slot);
    if (slot === 0) this.look.lightFor(header);
    if (slot === 1 && this.look.mode === 'single') this.look.mode = 'split';
    this.settleMode();
    this.retitle();
    this.panel.rebuild();
    this.touch();
  }

  /** Reads a file and shows it. */
  async open(file, slot) {
    const to = this.headers[0] ? slot : 0;
    say(`${file.name} is being read …`);
    try {
      const header = await this.source.headerOfFile(file);
      say(header.warnings.join('. '));
      if (this.stage) this.show(header, to);
      else this.headers[to] = header; // it is shown once the context is back
    } catch (error) {
      say(error.message);
    }
  }

  retitle() {
    const names = this.headers.filter(Boolean).map((header) => header.name);
    document.title = [...names, 'texf-view'].join(' · ');
    this.canvas.setAttribute('aria-label', `Picture of ${names.join(' and ') || 'nothing'}. Arrows turn it, H tells all keys.`);
  }

  // Look

  /** Changes what is shown, and how. */
  change(changes) {
    if ('mode' in changes && (changes.mode === 'side') !== (this.look.mode === 'side')) this.stage?.forget();
    if (this.stumbled) say('');
    const { isFramed } = this;
    this.stumbled = false;
    Object.assign(this.look, changes, 'lit' in changes ? { isLightChosen: true } : {});
    this.settleMode();
    if (isFramed) this.refit();
    this.touch();
  }

  /** One asset alone has no comparison. */
  settleMode() {
    if (this.stage && this.stage.filled.length < 2) this.look.mode = 'single';
  }

  switchMode(mode) {
    this.change({ mode: this.look.mode === mode ? 'single' : mode });
  }

  flip() {
    this.switchMode('other');
  }

  switchLight() {
    if (this.headers.some((header) => header?.light)) this.change({ lit: !this.look.lit });
    else mention('No material here is lit.');
  }

  help() {
    this.helper.showModal();
  }

  // Camera

  /** Of the address, or how the page is to begin. */
  firstCamera() {
    const camera = this.about.start?.camera ?? { direction: VIEWS.front };
    this.orbit = Orbit.of(camera, ...this.pictureSize());
    if (!camera.link) this.framed = this.orbit.distance;
    this.readHash();
    return this.orbit;
  }

  /** Takes the camera of the address's hash; whether there is one. */
  readHash() {
    const part = location.hash.slice(1).split('&').find((one) => one.startsWith(CAMERA));
    if (!part) return false;
    try {
      this.orbit = Orbit.fromLink(decodeURIComponent(part.slice(CAMERA.length)));
      return true;
    } catch (error) {
      say(error.message);
      return false;
    }
  }

  async copyCamera() {
    history.replaceState(null, '', `#${CAMERA}${this.orbit.link}`);
    try {
      await navigator.clipboard.writeText(location.href);
      mention('The camera is copied as a link.');
    } catch {
      mention('The camera stands in the address of this page.');
    }
  }

  /** Size of one asset's picture at full scale. */
  pictureSize() {
    const { width, height } = this.canvas, halves = this.look.mode === 'side' && this.stage?.filled.length > 1;
    return [halves ? width >> 1 : width, height];
  }

  get isFramed() {
    return this.orbit?.distance === this.framed;
  }

  /** Stands as far away as shows the whole asset. */
  refit() {
    const [width, height] = this.pictureSize(), { fov } = this.orbit;
    this.framed = fov ? distanceAround(fov, width, height) : height / Math.min(width, height);
    this.orbit.distance = this.framed;
  }

  frame() {
    this.orbit.target = [0, 0, 0];
    this.refit();
    this.moved();
  }

  view(number) {
    const direction = Object.values(VIEWS)[number], [azimuth, elevation] = anglesOf(direction);
    Object.assign(this.orbit, { azimuth, elevation, exact: direction });
    this.moved();
  }

  /** Between orthographic and perspective; what is around the target stays as large as it is. */
  switchProjection() {
    const { orbit, isFramed } = this, slope = (fov) => Math.tan((fov * Math.PI) / 360);
    if (orbit.fov) {
      this.fov = orbit.fov;
      Object.assign(orbit, { fov: 0, distance: orbit.distance * slope(this.fov) });
    } else {
      Object.assign(orbit, { fov: this.fov, distance: orbit.distance / slope(this.fov) });
    }
    if (isFramed) this.refit();
    this.moved();
  }

  moved() {
    this.touch();
  }

  /** Where the line between both pictures stands, a share of the width; null where there is none. */
  get line() {
    return this.look.mode === 'split' ? this.look.slider : null;
  }

  slide(share) {
    this.change({ slider: Math.min(1, Math.max(0, share)) });
  }

  // Frames

  /** Something has changed: draws while it does, and in full once it does no longer. */
  touch() {
    this.touched = performance.now();
    this.isSettled = false;
    this.refining = null;
    this.ask();
  }

  ask() {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.step();
    });
  }

  step() {
    if (!this.stage) return;
    this.fit();
    try {
      if (!this.stage.filled.length) this.finish(this.stage.clear(this.size, this.look));
      else if (performance.now() - this.touched < REST) this.move();
      else if (this.refine()) this.finish();
    } catch (error) {
      this.stumble(error);
    }
  }

  get size() {
    return [this.canvas.width, this.canvas.height];
  }

  /** Gives the canvas the pixels of its place on the page. */
  fit() {
    const { canvas } = this, dense = Math.min(MOST_DENSE, devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((length) => Math.max(1, Math.round(length * dense)));
    if (canvas.width === width && canvas.height === height) return;
    const { isFramed } = this;
    Object.assign(canvas, { width, height });
    this.stage.forget();
    if (this.orbit && isFramed) this.refit();
  }

  wishes(slots, scale) {
    return slots.map((slot) => this.stage.wish(slot, this.orbit, this.size, this.look, scale));
  }

  /** A picture for now: in full where it stands already, else as fine as keeps it moving. */
  move() {
    const { stage, look } = this, shown = stage.shownIn(look.mode), full = this.wishes(shown, 1);
    const scale = full.every((wish) => stage.stands(wish)) ? 1 : this.pace.scale;
    const wishes = scale === 1 ? full : this.wishes(shown, scale), known = stage.programs;
    const milliseconds = wishes.reduce((sum, wish) => sum + stage.draw(wish), 0);
    if (milliseconds > 0 && stage.programs === known) this.pace.took(scale, milliseconds);
    stage.present(wishes, look, this.size);
    this.follow();
    if (milliseconds > 0 && performance.now() - this.toldAt > TOLD_EVERY) this.tell(milliseconds, scale);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.ask(), this.touched + REST - performance.now());
  }

  /** Draws another strip of the full picture; whether that was the last. */
  refine() {
    this.refining ??= this.strips();
    if (this.refining.next().done) return true;
    this.ask();
    return false;
  }

  /** What is shown in full, then what a flip of the two would show. */
  *strips() {
    const { stage, look, pace } = this, shown = stage.shownIn(look.mode), wishes = this.wishes(shown, 1), known = stage.programs;
    let milliseconds = 0;
    for (const wish of wishes) {
      for (const strip of stage.drawn(wish, pace)) {
        milliseconds += strip;
        yield;
      }
    }
    stage.present(wishes, look, this.size);
    if (milliseconds > 0 && stage.programs === known) pace.took(1, milliseconds);
    if (milliseconds > 0) this.tell(milliseconds, 1);
    const all = this.wishes(stage.filled, 1);
    for (const wish of all) {
      for (const _ of stage.drawn(wish, pace)) yield _;
    }
    if (all.length > 1) this.compare(all);
  }

  compare(wishes) {
    const key = JSON.stringify([wishes.map((wish) => wish.key), this.look.background]);
    if (key !== this.compared.key) this.compared = { key, found: this.stage.compare(wishes, this.look.background) };
    this.panel.compare.tell(this.compared.found);
  }

  finish() {
    this.follow();
    this.isSettled = true;
  }

  /** Resolves once the picture stands in full. */
  async settled() {
    while (!this.isSettled) await new Promise((done) => { setTimeout(done, 10); });
  }

  /** What cannot be drawn is said, and the plain picture takes its place; where that is what fails, nothing does. */
  stumble(error) {
    if (this.gl.isContextLost()) return;
    const { look } = this, isPlain = look.layer === 'picture' && look.effects === 'scene' && !look.without.size && !look.lit;
    say(`This cannot be drawn. ${error.message}`);
    if (isPlain) this.isSettled = true;
    else this.change({ layer: 'picture', effects: 'scene', without: new Set(), lit: false });
    this.stumbled = true;
  }

  follow() {
    document.body.style.background = backgroundStyle(this.look.background);
    this.panel.follow();
    this.captions.follow(this.stage.assets.map((asset) => asset.header), this.look);
  }

  tell(milliseconds, scale) {
    this.toldAt = performance.now();
    this.panel.tell({ milliseconds, scale, size: this.size, renderer: rendererOf(this.gl) });
  }

  // Loss of the context

  lose(event) {
    event.preventDefault();
    cancelAnimationFrame(this.waiting);
    clearTimeout(this.timer);
    Object.assign(this, { stage: null, waiting: 0, refining: null, isSettled: false });
    say('The graphics context was lost; the picture comes back with it.');
  }

  restore() {
    say('');
    this.uploadAll();
    this.settleMode();
    this.panel.rebuild();
    this.touch();
  }
}
