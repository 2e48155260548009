// The panel beside the picture: what is shown, and how.

import { assetsSection } from './assets_panel.js';
import { ComparePanel } from './compare_panel.js';
import { element, tick } from './dom.js';
import { EffectsPanel } from './effects_panel.js';
import { timeText } from './facts.js';
import { BACKGROUNDS, layersOf } from './look.js';
import { backgroundStyle } from './present.js';

const NARROW = '(max-width: 700px)'; // where the panel would hide what it tells of

/**
 * viewer: of viewer.js; the panel reads its look, headers and sizes, and calls its change(), frame(), copyCamera(), help(),
 * open() and measure().
 */
export class Panel {
  constructor(viewer, version) {
    this.viewer = viewer;
    this.body = element('div', { className: 'body' });
    const title = element('summary', {}, 'texf-view ', element('small', {}, version ?? ''));
    this.root = element('details', { id: 'panel', open: !matchMedia(NARROW).matches }, title, this.body);
    this.timing = element('p', { className: 'timing' });
    this.renderer = element('p', { className: 'faint' });
    this.rebuild();
  }

  toggle() {
    this.root.open = !this.root.open;
  }

  /** Builds all of it anew: other assets are shown. */
  rebuild() {
    const { viewer } = this, headers = viewer.headers.filter(Boolean), isLit = headers.some((header) => header.light);
    this.compare = headers.length > 1 ? new ComparePanel(viewer) : null;
    this.effects = isLit ? new EffectsPanel(viewer) : null;
    this.body.replaceChildren(...[
      assetsSection(viewer), this.opening(),
      this.compare?.root, this.picture(headers, isLit), this.effects?.root, this.buttons(), this.timing, this.renderer,
    ].filter(Boolean));
    this.follow();
  }

  /** Where files are opened from; a page that stands alone has no server that could read them. */
  opening() {
    const { viewer } = this;
    if (!viewer.about.drop) return null;
    const opener = (text, slot) => {
      const input = element('input', { type: 'file', accept: '.texf,.glb', hidden: true });
      input.addEventListener('change', () => { if (input.files.length) viewer.open(input.files[0], slot); });
      return element('button', { type: 'button', on: { click: () => input.click() } }, text, input);
    };
    const both = viewer.headers.some(Boolean);
    const hint = `Or drop a .texf or .glb on the picture${both ? '; on its right half, or with Shift, to compare' : ''}.`;
    return element('section', {},
      element('div', { className: 'buttons' }, opener('Open …', 0), both ? opener('Compare with …', 1) : null),
      element('p', { className: 'faint' }, hint));
  }

  picture(headers, isLit) {
    const { viewer } = this, groups = Object.entries(layersOf(headers));
    const options = (rows) => rows.map(([value, textContent]) => element('option', { value, textContent }));
    const grouped = groups.map(([label, rows]) => (label ? [element('optgroup', { label }, ...options(rows))] : options(rows)));
    this.layer = element('select', { id: 'layer' }, ...grouped.flat());
    this.layer.addEventListener('change', () => viewer.change({ layer: this.layer.value }));
    this.light = tick('In light', { on: { change: () => viewer.change({ lit: this.light.box.checked }) } });
    this.light.box.disabled = !isLit;
    if (!isLit) this.light.label.title = 'No material here is lit.';
    this.deep = tick('Perspective', { on: { change: () => viewer.switchProjection() } });
    this.missing = element('p', { className: 'faint' });
    return element('section', {}, element('h2', {}, 'Picture'),
      element('div', { className: 'row' }, element('label', { htmlFor: 'layer' }, 'Layer'), this.layer), this.missing,
      element('div', { className: 'row' }, this.light.label, this.deep.label), this.backgrounds());
  }

  backgrounds() {
    const swatches = Object.entries(BACKGROUNDS).map(([name, colour]) => {
      const told = { 'aria-label': name, title: name };
      const input = element('input', { type: 'radio', name: 'background', value: colour.join(), ...told });
      input.addEventListener('change', () => this.viewer.change({ background: colour }));
      input.style.background = backgroundStyle(colour);
      return input;
    });
    this.swatches = swatches;
    return element('div', { className: 'row', role: 'radiogroup', 'aria-label': 'Background' }, 'Background',
      element('span', { className: 'swatches' }, ...swatches));
  }

  buttons() {
    const { viewer } = this;
    const button = (text, title, click) => element('button', { type: 'button', title, on: { click } }, text);
    return element('div', { className: 'buttons' }, button('Frame', 'F', () => viewer.frame()),
      button('Copy camera', 'C', () => viewer.copyCamera()), button('Help', 'H', () => viewer.help()));
  }

  /** Shows what the viewer's look is by now. */
  follow() {
    const { look, orbit } = this.viewer, headers = this.viewer.headers.filter(Boolean);
    if ([...this.layer.options].some(({ value }) => value === look.layer)) this.layer.value = look.layer;
    this.light.box.checked = look.lit;
    this.deep.box.checked = orbit.fov > 0;
    this.swatches.forEach((input) => { input.checked = input.value === look.background.join(); });
    const without = headers.filter((header) => look.layerOf(header) !== look.layer).map((header) => header.name);
    this.missing.textContent = without.length ? `${without.join(' and ')}: no such layer, shown in grey.` : '';
    this.compare?.follow();
    this.effects?.follow();
  }

  /** Tells how long the frame took, and what drew it. */
  tell({ milliseconds, size: [width, height], scale, renderer }) {
    const share = scale < 1 ? `, at ${width * scale} × ${height * scale}` : `, ${width} × ${height}`;
    this.timing.textContent = `Frame ${timeText(milliseconds)}${share}`;
    this.renderer.textContent = renderer;
  }
}
