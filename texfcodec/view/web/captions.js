// Names on the picture: on both sides of the line between two, or of the one that is shown.

import { element } from './dom.js';

export class Captions {
  constructor(canvas) {
    this.canvas = canvas;
    this.names = [0, 1].map(() => element('span'));
    this.root = element('div', { id: 'captions', 'aria-hidden': 'true' }, ...this.names);
  }

  /** texts: of first and second; one of them alone has no need of a name. */
  follow(texts, { mode, slider }) {
    const shown = { single: [0], other: [1], split: [0, 1], side: [0, 1] }[mode] ?? [];
    this.root.hidden = texts.length < 2 || !shown.length;
    this.names.forEach((name, n) => Object.assign(name, { textContent: texts[n] ?? '', hidden: !shown.includes(n) }));
    this.root.classList.toggle('alone', shown.length === 1);
    const { left, width } = this.canvas.getBoundingClientRect();
    this.root.style.left = `${left + width * (mode === 'split' ? slider : 0.5)}px`;
  }
}
