// What keys do, and the page of help that says so.

import { element } from './dom.js';

const STEP = 5, SHIFTED = 0.05; // degrees; shares of the picture's height
const CLOSER = 0.9;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const TYPED = 'select, textarea, [contenteditable], input:not([type=checkbox], [type=radio], [type=range], [type=button])';
const OWN = 'button, input, summary, a, select'; // which have a use of their own for arrows, the space bar and Enter

const HELP = [
  ['Drag', 'turns'], ['Right drag, Shift + drag, two fingers', 'moves'], ['Wheel, pinch', 'zooms'],
  ['Double click, F', 'frames the asset again'], ['Arrows', 'turn; with Shift they move'], ['+ −', 'zoom'],
  ['1 … 6', 'front, back, left, right, top, bottom'], ['O', 'orthographic or perspective'], ['L', 'light on or off'],
  ['C', 'copies the camera as a link'], ['Space', 'flips between first and second'], ['S', 'both, with a line between'],
  ['A', 'both, side by side'], ['D', 'their difference'], ['P', 'panel'], ['H, ?', 'this help'],
];

/**
 * Listens to the keys of the page. hands: { orbit(), moved(), frame(), view(number), flip(), and what ACTIONS name }.
 */
export function listenToKeys(hands) {
  const letters = {
    f: hands.frame, o: hands.switchProjection, l: hands.switchLight, ' ': hands.flip, s: () => hands.switchMode('split'),
    a: () => hands.switchMode('side'), d: () => hands.switchMode('difference'), c: hands.copyCamera, h: hands.help, '?': hands.help,
    p: hands.switchPanel, '+': () => zoomed(hands, CLOSER), '=': () => zoomed(hands, CLOSER), '-': () => zoomed(hands, 1 / CLOSER),
    ...Object.fromEntries([1, 2, 3, 4, 5, 6].map((number) => [String(number), () => hands.view(number - 1)])),
  };
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || document.querySelector('dialog[open]')) return;
    const { target, key } = event, isControl = target.closest?.(OWN), action = letters[key.toLowerCase()];
    if (target.closest?.(TYPED) || (isControl && (key in ARROWS || key === ' '))) return;
    if (!(key in ARROWS) && !action) return;
    event.preventDefault();
    if (key in ARROWS) arrow(hands, ARROWS[key], event.shiftKey);
    else if (!event.repeat || '+=-'.includes(key)) action();
  });
}

function arrow(hands, [right, up], isShifted) {
  if (isShifted) hands.orbit().pan(right * SHIFTED, up * SHIFTED);
  else hands.orbit().turn(right * STEP, up * STEP);
  hands.moved();
}

function zoomed(hands, factor) {
  hands.orbit().zoom(factor);
  hands.moved();
}

/** The page of help, closed. */
export function helpBox() {
  const rows = HELP.map(([keys, does]) => element('tr', {}, element('th', { scope: 'row' }, keys), element('td', {}, does)));
  const close = element('button', { type: 'button', textContent: 'Close', autofocus: true });
  const box = element('dialog', { id: 'help', 'aria-label': 'Help' }, element('h2', {}, 'How to look'), element('table', {}, ...rows), close);
  close.addEventListener('click', () => box.close());
  box.addEventListener('click', (event) => { if (event.target === box) box.close(); });
  return box;
}
