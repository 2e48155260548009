// The panel beside the picture: what is shown, and how.

import {element, tick} from './dom.js';
import {decibelText, factsOf, grouped, timeText} from './facts.js';
import {effectsOf, hasLayer, layersOf, worded} from './shown_layers.js';
import {HEAT, ONLY_ONE} from './stage.js';

export const BACKGROUNDS = {
  Grey: 'linear-gradient(rgb(150 150 150), rgb(104 104 104))', White: 'rgb(255 255 255)', Light: 'rgb(221 223 226)',
  Middle: 'rgb(128 130 134)', Dark: 'rgb(30 32 36)', Black: 'rgb(0 0 0)',
};
const NARROW = '(max-width: 700px)'; // where the panel would hide what it tells of
const ORDINALS = ['First', 'Second'];
const MODES = {single: 'First', other: 'Second', split: 'Line', side: 'Beside', difference: 'Difference'};
const PSNR = ['PSNR', 'Red', 'Green', 'Blue'];
const HOT = [1, 2, 4, 8, 16, 32, 64, 128, 255]; // levels at which the heat map is at its hottest

export class Panel {
  /** viewer: of viewer.js. */
  constructor(viewer) {
    this.viewer = viewer;
    this.body = element('div', {className: 'body'});
    const title = element('summary', {}, 'texf-view ', element('small', {}, viewer.about.version ?? ''));
    this.root = element('details', {id: 'panel', open: !matchMedia(NARROW).matches}, title, this.body);
    this.timing = element('p', {className: 'timing'});
    this.rebuild();
  }

  toggle() {
    this.root.open = !this.root.open;
  }

  /** Builds all of it anew: other assets are shown. */
  rebuild() {
    const {assets} = this.viewer;
    this.compare = assets.length > 1 ? new Compare(this.viewer) : null;
    this.body.replaceChildren(...[
      assetsSection(assets), this.opening(), this.compare?.root, this.picture(), this.effects(), this.buttons(), this.timing,
    ].filter(Boolean));
    this.follow();
  }

  opening() {
    const {viewer} = this, both = viewer.assets.length > 0;
    const opener = (text, slot) => {
      const input = element('input', {type: 'file', hidden: true, on: {change: () => input.files.length && viewer.open(input.files[0], slot)}});
      return element('button', {type: 'button', on: {click: () => input.click()}}, text, input);
    };
    const hint = `Or drop a .texf${viewer.about.drop ? ', a .glb or another mesh' : ' or a .glb'} on the picture${both ? '; on its right half, or with Shift, to compare' : ''}.`;
    return element('section', {}, element('div', {className: 'buttons'}, opener('Open …', 0), both ? opener('Compare with …', 1) : null),
      element('p', {className: 'faint'}, hint));
  }

  picture() {
    const {viewer} = this, isLit = viewer.assets.some((asset) => asset.isLit);
    const options = (rows) => rows.map(([value, textContent]) => element('option', {value, textContent}));
    const all = Object.entries(layersOf(viewer.assets)).flatMap(([label, rows]) => (label ? [element('optgroup', {label}, ...options(rows))] : options(rows)));
    this.layer = element('select', {id: 'layer', on: {change: () => viewer.change({layer: this.layer.value})}}, ...all);
    this.light = tick('In light', (lit) => viewer.change({lit}));
    this.light.box.disabled = !isLit;
    if (!isLit) this.light.label.title = 'No material here is lit.';
    this.deep = tick('Perspective', () => viewer.switchProjection());
    this.missing = element('p', {className: 'faint'});
    this.swatches = Object.entries(BACKGROUNDS).map(([name, background]) => {
      const input = element('input', {type: 'radio', name: 'background', value: background, 'aria-label': name, title: name, on: {change: () => viewer.change({background})}});
      input.style.background = background;
      return input;
    });
    return element('section', {}, element('h2', {}, 'Picture'),
      element('div', {className: 'row'}, element('label', {htmlFor: 'layer'}, 'Layer'), this.layer), this.missing,
      element('div', {className: 'row'}, this.light.label, this.deep.label),
      element('div', {className: 'row', role: 'radiogroup', 'aria-label': 'Background'}, 'Background', element('span', {className: 'swatches'}, ...this.swatches)));
  }

  /** Ticks for the effects that the materials use. */
  effects() {
    const {viewer} = this, names = effectsOf(viewer.assets);
    this.ticks = names.map((name) => [name, tick(worded(name), (isOn) => {
      const without = new Set(viewer.settings.without);
      without[isOn ? 'delete' : 'add'](name);
      viewer.change({without, lit: true});
    })]);
    if (!names.length) return null;
    return element('section', {className: 'effects'}, element('details', {},
      element('summary', {}, element('h2', {}, 'Effects'), element('small', {}, `${names.length} in use`)), ...this.ticks.map(([, {label}]) => label)));
  }

  buttons() {
    const {viewer} = this, button = (text, title, click) => element('button', {type: 'button', title, on: {click}}, text);
    return element('div', {className: 'buttons'}, button('Frame', 'F', () => viewer.frame()),
      button('Copy camera', 'C', () => viewer.copyCamera()), button('Help', 'H', () => viewer.helper.showModal()));
  }

  /** Shows what the viewer's settings are by now. */
  follow() {
    const {settings, view, assets} = this.viewer;
    if ([...this.layer.options].some(({value}) => value === settings.layer)) this.layer.value = settings.layer;
    this.light.box.checked = settings.lit && !this.light.box.disabled;
    this.deep.box.checked = Boolean(view?.isDeep);
    this.swatches.forEach((input) => { input.checked = input.value === settings.background; });
    this.ticks.forEach(([name, {box}]) => { box.checked = !settings.without.has(name); });
    const without = assets.filter((asset) => !hasLayer(asset, settings.layer)).map(({name}) => name);
    this.missing.textContent = without.length ? `${without.join(' and ')}: no such layer, shown in grey.` : '';
    this.compare?.follow();
  }

  /** Tells how long the frame took. */
  tell(milliseconds, size) {
    this.timing.textContent = `Frame ${timeText(milliseconds)}, ${size.join(' × ')}`;
  }
}

/** How two assets are compared: which of them, both with a line between, side by side, their difference, and by how much. */
class Compare {
  constructor(viewer) {
    this.viewer = viewer;
    this.modes = Object.entries(MODES).map(([value, text]) => {
      const input = element('input', {type: 'radio', name: 'mode', value, on: {change: () => viewer.change({mode: value})}});
      return {input, label: element('label', {}, input, element('span', {}, text))};
    });
    this.figures = PSNR.map(() => element('td', {}, '…'));
    this.pixels = element('p', {className: 'faint'});
    this.apart = element('p', {className: 'problem', textContent: 'They are in different places: each is framed by itself.'});
    this.root = element('section', {}, element('h2', {}, 'Compare'),
      element('div', {className: 'modes', role: 'radiogroup', 'aria-label': 'Comparison'}, ...this.modes.map(({label}) => label)), this.apart, this.heat(),
      element('table', {id: 'psnr'}, element('tr', {}, ...PSNR.map((name) => element('th', {scope: 'col'}, name))), element('tr', {}, ...this.figures)), this.pixels);
  }

  /** The difference's scale, and its colours as a strip from nothing to the hottest. */
  heat() {
    const colour = (rgb) => `rgb(${rgb.join(' ')})`, strip = element('div', {className: 'heat', role: 'img', 'aria-label': 'Colours'});
    strip.style.backgroundImage = `linear-gradient(to right, ${HEAT.map(colour).join(', ')})`;
    const only = element('span', {className: 'dot'});
    only.style.backgroundColor = colour(ONLY_ONE);
    this.scale = element('input', {
      type: 'range', max: HOT.length - 1, step: 1, 'aria-label': 'Scale of the difference', on: {input: () => this.viewer.change({hottest: HOT[this.scale.value]})},
    });
    this.hottest = element('span');
    this.heatRows = element('div', {}, element('div', {className: 'row'}, 'Scale', this.scale), strip,
      element('div', {className: 'ends'}, element('span', {}, '0'), this.hottest), element('p', {className: 'faint'}, only, 'only one is there'));
    return this.heatRows;
  }

  follow() {
    const {settings, stage} = this.viewer;
    this.modes.forEach(({input}) => { input.checked = input.value === settings.mode; });
    this.apart.hidden = !stage.apart;
    this.heatRows.hidden = settings.mode !== 'difference';
    this.scale.value = Math.max(0, HOT.findLastIndex((scale) => scale <= settings.hottest));
    this.hottest.textContent = `${settings.hottest} of 255`;
  }

  /** Shows PSNR of the view (of psnrOf()). */
  tell({rgb, channels, both, only}) {
    [rgb, ...channels].map(decibelText).forEach((text, n) => { this.figures[n].textContent = text; });
    this.pixels.textContent = `dB of this view, over ${grouped(both)} pixels; ${grouped(only)} show only one`;
  }
}

/** Names and figures of assets, beside each other if there are two. */
function assetsSection(assets) {
  if (!assets.length) return element('section', {}, element('p', {className: 'faint'}, 'Nothing is open.'));
  const names = assets.map(({name}, n) => element('h2', {title: name}, assets.length > 1 ? element('small', {}, ORDINALS[n]) : null, name || 'without a name'));
  const columns = assets.map((asset) => new Map(factsOf(asset))), rows = [...new Set(columns.flatMap((column) => [...column.keys()]))];
  const head = element('tr', {}, element('td'), ...assets.map((_, n) => element('th', {scope: 'col'}, ORDINALS[n])));
  const table = element('table', {className: 'facts'}, assets.length > 1 ? head : null, ...rows.map((name) => element('tr', {},
    element('th', {scope: 'row'}, name), ...columns.map((column) => element('td', {}, column.get(name) ?? '–')))));
  const warnings = assets.filter((asset) => asset.warnings.length).map(({name, warnings: lines}) => element('details', {className: 'rows'},
    element('summary', {}, `${lines.length} warning${lines.length > 1 ? 's' : ''} of ${name}`), element('ul', {}, ...lines.map((line) => element('li', {}, line)))));
  return element('section', {className: 'assets'}, ...names, table, ...warnings);
}
