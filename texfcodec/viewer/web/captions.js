// Names on the picture: on both sides of the line between two, of the one that is shown, or of their difference.

import { element } from './dom.js';
import { differenceText, halvesOf } from './look.js';

/** What is shown of two headers: [the texts, whether they stand on both sides]. */
export function captionsOf(headers, { mode, hottest }) {
  if (headers.length < 2) return [[], false];
  const halves = halvesOf(headers);
  if (mode === 'split' || mode === 'side') return [halves, true];
  return [{ single: [halves[0]], other: [halves[1]], difference: [differenceText(hottest)] }[mode] ?? [], false];
}

export class Captions {
  constructor(canvas) {
    this.canvas = canvas;
    this.names = [0, 1].map(() => element('span'));
    this.root = element('div', { id: 'captions', 'aria-hidden': 'true' }, ...this.names);
  }

  /** headers: of first and second; one of them alone has no need of a name. */
  follow(headers, look) {
    const [texts, areTwo] = captionsOf(headers, look), { left, width } = this.canvas.getBoundingClientRect();
    this.root.hidden = !texts.length;
    this.names.forEach((name, n) => Object.assign(name, { textContent: texts[n] ?? '', hidden: !texts[n] }));
    this.root.classList.toggle('alone', !areTwo);
    this.root.style.left = `${left + width * (look.mode === 'split' ? look.slider : 0.5)}px`;
  }
}

/** Writes the same on a picture of a 2D context. */
export function drawCaptions(context, headers, look) {
  const [texts, areTwo] = captionsOf(headers, look), { width } = context.canvas, size = Math.min(32, Math.max(9, width / 64));
  const most = (areTwo ? width / 2 : width) - 2 * size;
  Object.assign(context, { font: `${size}px system-ui, sans-serif`, textBaseline: 'middle' });
  texts.forEach((text, n) => {
    const long = Math.min(context.measureText(text).width, most - 2 * size);
    const begin = areTwo ? [width / 2 - size / 2 - long - size, width / 2 + size / 2][n] : (width - long - size) / 2;
    context.fillStyle = 'rgb(255 255 255 / 94%)';
    context.fillRect(begin, size / 2, long + size, 1.7 * size);
    context.fillStyle = '#1d2126';
    context.fillText(text, begin + size / 2, 1.35 * size, long);
  });
}
