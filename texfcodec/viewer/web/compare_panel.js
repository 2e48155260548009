// How two assets are compared: which of them, both with a line between, side by side, their difference, and by how much.

import { element } from './dom.js';
import { decibelText, grouped } from './facts.js';
import { HEAT, ONLY_ONE } from './present.js';

const NAMES = { single: 'First', other: 'Second', split: 'Line', side: 'Beside', difference: 'Difference' };
const PSNR = ['PSNR', 'Red', 'Green', 'Blue'];
const HOT = [1, 2, 4, 8, 16, 32, 64, 128, 255]; // levels at which the heat map is at its hottest

export class ComparePanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.modes = Object.entries(NAMES).map(([value, text]) => {
      const input = element('input', { type: 'radio', name: 'mode', value });
      input.addEventListener('change', () => viewer.change({ mode: value }));
      return { input, label: element('label', {}, input, element('span', {}, text)) };
    });
    this.figures = PSNR.map(() => element('td'));
    this.pixels = element('p', { className: 'faint' });
    this.apart = element('p', { className: 'problem', textContent: 'They stand in different places: each is framed by itself.' });
    const labels = this.modes.map(({ label }) => label), heads = PSNR.map((name) => element('th', { scope: 'col' }, name));
    this.root = element('section', {}, element('h2', {}, 'Compare'),
      element('div', { className: 'modes', role: 'radiogroup', 'aria-label': 'Comparison' }, ...labels),
      this.apart, this.line(), this.heat(),
      element('table', { id: 'psnr' }, element('tr', {}, ...heads), element('tr', {}, ...this.figures)), this.pixels);
  }

  line() {
    this.slider = element('input', { type: 'range', min: 0, max: 1, step: 0.001, 'aria-label': 'Line between both' });
    this.slider.addEventListener('input', () => this.viewer.change({ slider: Number(this.slider.value) }));
    this.lineRow = element('div', { className: 'row' }, 'Line', this.slider);
    return this.lineRow;
  }

  /** The difference's scale, and its colours as a strip from nothing to the hottest. */
  heat() {
    const colour = (rgb) => `rgb(${rgb.join(' ')})`;
    const strip = element('div', { className: 'heat', role: 'img', 'aria-label': 'Colours' });
    strip.style.backgroundImage = `linear-gradient(to right, ${HEAT.map(colour).join(', ')})`;
    const only = element('span', { className: 'dot' });
    only.style.backgroundColor = colour(ONLY_ONE);
    this.scale = element('input', { type: 'range', max: HOT.length - 1, step: 1, 'aria-label': 'Scale of the difference' });
    this.scale.addEventListener('input', () => this.viewer.change({ hottest: HOT[this.scale.value] }));
    this.hottest = element('span');
    this.heatRows = element('div', {}, element('div', { className: 'row' }, 'Scale', this.scale), strip,
      element('div', { className: 'ends' }, element('span', {}, '0'), this.hottest),
      element('p', { className: 'faint' }, only, 'only one is there'));
    return this.heatRows;
  }

  follow() {
    const { look } = this.viewer;
    this.modes.forEach(({ input }) => { input.checked = input.value === look.mode; });
    this.slider.value = look.slider;
    this.apart.hidden = !this.viewer.stage?.apart;
    this.lineRow.hidden = look.mode !== 'split';
    this.heatRows.hidden = look.mode !== 'difference';
    this.scale.value = Math.max(0, HOT.findLastIndex((scale) => scale <= look.hottest));
    this.hottest.textContent = `${look.hottest} of 255`;
  }

  /** Shows PSNR of the view (of psnrOf()), or, for null, that it is not known yet. */
  tell(found) {
    const values = found ? [found.rgb, ...found.channels].map(decibelText) : PSNR.map(() => '…');
    this.figures.forEach((cell, n) => { cell.textContent = values[n]; });
    const [both, only] = found ? [found.both, found.only].map(grouped) : [];
    this.pixels.textContent = found ? `dB of this view, over ${both} pixels; ${only} show only one` : '';
  }
}
