// The page as a person uses it.

import {element, mention, say} from './dom.js';
import {helpBox, listenToKeys} from './keys.js';
import {BACKGROUNDS, Panel} from './panel.js';
import {HOTTEST, Stage} from './stage.js';
import {View, VIEWS} from './view.js';

const REST = 180; // milliseconds without a change after which the picture is drawn in full
const SLOW = 50, QUICK = 15; // milliseconds of a frame, between which a moving picture keeps its density
const COARSEST = 1 / 8, MOST_DENSE = 2; // pixels of the canvas to one of the page
const CAMERA = 'camera=';

export class Viewer {
  constructor(canvas, source) {
    const {start} = source.about;
    Object.assign(this, {canvas, source, about: source.about, isSettled: false, isMoving: false, timer: 0, frameAsked: 0, density: 1, compared: null});
    this.settings = {
      mode: start?.mode ?? 'single', layer: start?.layer ?? 'picture', lit: start?.shaded ?? true, without: new Set(), slider: 0.5, hottest: HOTTEST,
      background: start?.background ?? BACKGROUNDS.Grey,
    };
    this.stage = stageOf(canvas, source.about.light);
    canvas.viewer = this; // for a browser's console, and for tests
    this.view = new View(canvas, () => this.touch());
    this.line = lineOf(this);
    this.names = [0, 1].map(() => element('span'));
    this.captions = element('div', {id: 'captions', 'aria-hidden': 'true'}, ...this.names);
    this.panel = new Panel(this);
    this.helper = helpBox();
    document.body.append(this.captions, this.line, this.panel.root, this.helper);
    this.resize();
    this.firstCamera(start?.camera);
    this.listen();
    this.touch();
  }

  listen() {
    const {canvas} = this;
    listenToKeys(this);
    listenToDrops(this);
    new ResizeObserver(() => this.resize()).observe(canvas);
    addEventListener('hashchange', () => this.readHash());
    canvas.addEventListener('dblclick', () => this.frame());
    canvas.addEventListener('webglcontextlost', () => {
      this.isSettled = false;
      say('The graphics context was lost; the picture comes back with it.');
    });
    canvas.addEventListener('webglcontextrestored', () => setTimeout(() => { // once three.js has heard of it
      say('');
      if (this.stage.scene.environment) this.stage.lightUp();
      this.touch();
    }));
  }

  get assets() {
    return this.stage.assets;
  }

  /** Shows an Asset in slot 0 or 1, in place of what is there. */
  show(asset, slot) {
    const isFirst = slot === 0 && !this.hasHash;
    try {
      this.stage.load(slot, asset);
    } catch (error) {
      say(`${asset.name} cannot be shown. ${error.message}`);
    }
    if (asset.mixer && !asset.warnings.length) mention(`${asset.name} is animated: M plays it.`);
    document.title = [...this.assets.map(({name}) => name), 'texf-view'].join(' · ');
    this.canvas.setAttribute('aria-label', `Picture of ${this.assets.map(({name}) => name).join(' and ') || 'nothing'}. Arrows turn it, H lists all keys.`);
    this.panel.rebuild();
    if (isFirst || this.view.isFitted) this.frame();
    this.touch();
  }

  /** Reads a file and shows it. */
  async open(file, slot) {
    say(`${file.name} is being read …`);
    try {
      const asset = await this.source.open(file);
      say(asset.warnings.join('. '));
      this.show(asset, this.assets.length ? slot : 0);
      if (slot === 1 && this.settings.mode === 'single') this.switchMode('split');
    } catch (error) {
      say(error.message);
    }
  }

  /** Changes what is shown, and how. */
  change(changes) {
    const {isFitted} = this.view;
    Object.assign(this.settings, changes);
    if (isFitted && 'mode' in changes) this.frame();
    this.touch();
  }

  switchMode(mode) {
    if (this.assets.length > 1) this.change({mode: this.settings.mode === mode ? 'single' : mode});
  }

  switchLight() {
    if (this.assets.some(({isLit}) => isLit)) this.change({lit: !this.settings.lit});
    else mention('No material here is lit.');
  }

  /** Plays or stops the first animation of what is shown. */
  switchMotion() {
    if (!this.assets.some(({mixer}) => mixer)) return mention('Nothing here is animated.');
    this.isMoving = !this.isMoving;
    this.movedAt = performance.now();
    return this.move();
  }

  move() {
    if (!this.isMoving) return;
    const now = performance.now();
    for (const {mixer} of this.assets) mixer?.update((now - this.movedAt) / 1000);
    this.movedAt = now;
    this.touch();
    requestAnimationFrame(() => this.move());
  }

  /** Where the line between two pictures is, a share of the width. */
  slide(share) {
    this.change({slider: Math.min(1, Math.max(0, share))});
  }

  // Camera

  firstCamera(camera) {
    if (camera?.link) this.view.link = camera.link;
    else {
      this.view.look(camera?.direction ?? VIEWS[0]);
      if (camera?.perspective) this.view.set({fov: camera.perspective});
    }
    this.hasHash = Boolean(camera?.link) || this.readHash();
  }

  /** Takes the camera of the address's hash; whether there is one. */
  readHash() {
    const part = location.hash.slice(1).split('&').find((text) => text.startsWith(CAMERA));
    if (!part) return false;
    try {
      this.view.link = decodeURIComponent(part.slice(CAMERA.length));
      return true;
    } catch (error) {
      say(error.message);
      return false;
    }
  }

  async copyCamera() {
    history.replaceState(null, '', `#${CAMERA}${this.view.link}`);
    try {
      await navigator.clipboard.writeText(location.href);
      mention('The camera is copied as a link.');
    } catch {
      mention('The camera is in the address of this page.');
    }
  }

  /** Frames what is shown. */
  frame() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight], isHalf = this.settings.mode === 'side' && this.assets.length > 1;
    this.view.aim([isHalf ? width / 2 : width, height], this.stage.reach);
    this.view.fit(this.stage.parts(this.stage.shownIn(this.settings.mode)));
  }

  lookFrom(number) {
    const {isFitted} = this.view;
    this.view.look(VIEWS[number]);
    if (isFitted) this.frame();
  }

  switchProjection() {
    const {isFitted} = this.view;
    this.view.switchProjection();
    if (isFitted) this.frame();
  }

  // Frames

  resize() {
    const {isFitted} = this.view;
    this.setDensity(1);
    if (isFitted) this.frame();
    this.touch();
  }

  /** density: 1 for all the pixels that the screen has, less for coarser ones. */
  setDensity(density) {
    const {clientWidth, clientHeight} = this.canvas, key = [clientWidth, clientHeight, density, devicePixelRatio].join();
    if (key === this.sized) return;
    this.sized = key;
    this.stage.resize(Math.max(1, clientWidth), Math.max(1, clientHeight), density * Math.min(MOST_DENSE, devicePixelRatio || 1));
  }

  /** Something has changed: draws it as fine as keeps it moving, and in full once nothing changes any longer. */
  touch() {
    this.isSettled = false;
    clearTimeout(this.timer);
    this.frameAsked ||= requestAnimationFrame(() => {
      this.frameAsked = 0;
      const milliseconds = this.draw(this.density);
      if (milliseconds > SLOW) this.density = Math.max(COARSEST, this.density / 2);
      else if (milliseconds < QUICK) this.density = Math.min(1, this.density * 2);
      this.timer = setTimeout(() => this.rest(), REST);
    });
  }

  /** Milliseconds of a frame. */
  draw(density) {
    const begin = performance.now();
    this.setDensity(density);
    this.stage.draw(this.view, this.settings);
    this.stage.wait();
    this.follow();
    return performance.now() - begin;
  }

  rest() {
    if (this.stage.renderer.getContext().isContextLost()) return;
    this.setDensity(1);
    if (this.assets.length > 1) this.panel.compare.tell(this.stage.compare(this.view, this.settings));
    this.panel.tell(this.draw(1), this.stage.size);
    this.isSettled = true;
  }

  /** Resolves once the picture is drawn in full. */
  async settled() {
    while (!this.isSettled) await new Promise((done) => { setTimeout(done, 10); });
  }

  follow() {
    const {settings, assets} = this, {left, width, top, height} = this.canvas.getBoundingClientRect(), isPair = assets.length > 1;
    document.body.style.background = settings.background;
    const kinds = assets.map(({kind}) => (kind === 'mesh' ? 'source' : 'stream')), words = kinds[0] === kinds[1] ? ['first', 'second'] : kinds;
    const halves = assets.map(({name}, n) => `${words[n]}: ${name}`), areTwo = settings.mode === 'split' || settings.mode === 'side';
    const texts = !isPair ? [] : areTwo ? halves
      : {single: [halves[0]], other: [halves[1]], difference: [`difference: 0 to ${settings.hottest} of 255, RMS of R, G, B`]}[settings.mode];
    this.names.forEach((name, n) => Object.assign(name, {textContent: texts[n] ?? '', hidden: !texts[n]}));
    this.captions.hidden = !texts.length;
    this.captions.classList.toggle('alone', !areTwo);
    this.captions.style.left = `${left + width * (settings.mode === 'split' ? settings.slider : 0.5)}px`;
    this.line.hidden = !isPair || settings.mode !== 'split';
    Object.assign(this.line.style, {left: `${left + width * settings.slider}px`, top: `${top}px`, height: `${height}px`});
    this.line.setAttribute('aria-valuenow', Math.round(100 * settings.slider));
    this.panel.follow();
  }
}

function stageOf(canvas, light) {
  try {
    return new Stage(canvas, light);
  } catch (error) {
    throw new Error('This browser has no WebGL2, with which the page draws.', {cause: error});
  }
}

const SLIDES = {ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1};

/** The line between two pictures, to be dragged. */
function lineOf(viewer) {
  const line = element('div', {
    id: 'line', role: 'slider', tabIndex: 0, hidden: true, 'aria-label': 'Line between both', 'aria-orientation': 'horizontal', 'aria-valuemin': 0, 'aria-valuemax': 100,
  });
  line.addEventListener('keydown', (event) => {
    if (!(event.key in SLIDES)) return;
    event.preventDefault();
    viewer.slide(viewer.settings.slider + SLIDES[event.key]);
  });
  line.addEventListener('pointerdown', (event) => line.setPointerCapture(event.pointerId));
  line.addEventListener('pointermove', (event) => {
    if (!line.hasPointerCapture(event.pointerId)) return;
    const {left, width} = viewer.canvas.getBoundingClientRect();
    viewer.slide((event.clientX - left) / width);
  });
  return line;
}

/** Shows what is dropped anywhere on the page. */
function listenToDrops(viewer) {
  const place = element('div', {id: 'drop', hidden: true}), area = () => viewer.canvas.getBoundingClientRect();
  const isSecond = ({shiftKey, clientX}) => viewer.assets.length > 0 && (shiftKey || clientX > area().left + area().width / 2);
  document.body.append(place);
  document.addEventListener('dragover', (event) => {
    if (!event.dataTransfer?.types.includes('Files')) return;
    event.preventDefault();
    const {left, width} = area(), half = width / 2, second = isSecond(event);
    Object.assign(place.style, {left: `${left + (second ? half : 0)}px`, width: `${viewer.assets.length ? half : width}px`});
    Object.assign(place, {hidden: false, textContent: second ? 'Compare with this' : 'Show this'});
  });
  document.addEventListener('dragleave', (event) => { place.hidden ||= event.relatedTarget === null; });
  document.addEventListener('drop', (event) => {
    if (!event.dataTransfer?.types.includes('Files')) return;
    event.preventDefault();
    place.hidden = true;
    const [file, other] = event.dataTransfer.files;
    if (file) viewer.open(file, isSecond(event) ? 1 : 0).then(() => other && viewer.open(other, 1));
  });
}
