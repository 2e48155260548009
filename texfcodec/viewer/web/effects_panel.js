// Terms of shading: which of those that the materials call for are drawn, and what each costs.

import { element, tick } from './dom.js';
import { timeText } from './facts.js';
import { termsOf, worded } from './look.js';
import { measureTerms } from './measure.js';

export class EffectsPanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.names = termsOf(viewer.headers.filter(Boolean));
    this.ticks = this.names.map((name) => tick(worded(name), { on: { change: () => this.change() } }));
    this.costs = this.names.map(() => element('td'));
    this.all = tick('All terms there are, for comparison', {});
    this.all.box.addEventListener('change', () => viewer.change({ effects: this.all.box.checked ? 'all' : 'scene' }));
    this.button = element('button', { type: 'button', on: { click: () => this.measure() } }, 'Measure');
    this.told = element('p', { className: 'faint' });
    const rows = this.ticks.map(({ label }, n) => element('tr', {}, element('td', {}, label), this.costs[n]));
    this.root = element('section', { className: 'effects' }, element('details', {},
      element('summary', {}, element('h2', {}, 'Effects'), element('small', {}, `${this.names.length} of the scene`)),
      element('table', {}, ...rows), this.all.label, element('div', { className: 'buttons' }, this.button), this.told));
  }

  change() {
    this.viewer.change({ lit: true, without: new Set(this.names.filter((_, n) => !this.ticks[n].box.checked)) });
  }

  follow() {
    const { look } = this.viewer;
    this.names.forEach((name, n) => {
      Object.assign(this.ticks[n].box, { checked: !look.without.has(name), disabled: look.effects === 'all' });
    });
    this.all.box.checked = look.effects === 'all';
  }

  /** Measures frames with all and without each, and tells of them as they come. */
  async measure() {
    this.button.disabled = true;
    this.told.textContent = 'Measuring …';
    try {
      const { size, frame, all } = await measureTerms(this.viewer, this.names, (name, milliseconds) => {
        this.costs[this.names.indexOf(name)].textContent = `without: ${timeText(milliseconds)}`;
      });
      this.told.textContent = `Frame with the scene's: ${timeText(frame)}, with all: ${timeText(all)}, ${size.join(' × ')}`;
    } catch (error) {
      this.told.textContent = error.message;
    }
    this.button.disabled = false;
  }
}
