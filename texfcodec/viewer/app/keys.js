// What keys do, and the page of help that says so.

import {element} from './dom.js';

const STEP = 5, SHIFTED = 0.05; // degrees; shares of the picture's height
const CLOSER = 0.9;
const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
const TYPED = 'select, textarea, [contenteditable], input:not([type=checkbox], [type=radio], [type=range], [type=button])';
const OWN = 'button, input, summary, a, select, [role=slider]'; // which have a use of their own for arrows, the space bar and Enter

const HELP = [
  ['Drag', 'turns'], ['Right drag, Shift + drag, two fingers', 'moves'], ['Wheel, pinch', 'zooms'],
  ['Double click, F', 'frames the asset again'], ['Arrows', 'turn; with Shift they move'], ['+ −', 'zoom'],
  ['1 … 6', 'front, back, left, right, top, bottom'], ['O', 'orthographic or perspective'], ['L', 'light on or off'], ['M', 'plays or stops an animation'],
  ['C', 'copies the camera as a link'], ['Space', 'flips between first and second'], ['S', 'both, with a line between'],
  ['A', 'both, side by side'], ['D', 'their difference'], ['P', 'panel'], ['H, ?', 'this help'],
];

/** Listens to the keys of the page. viewer: of viewer.js. */
export function listenToKeys(viewer) {
  const {view} = viewer, closer = () => view.zoom(CLOSER);
  const actions = {
    f: () => viewer.frame(), o: () => viewer.switchProjection(), l: () => viewer.switchLight(), m: () => viewer.switchMotion(), c: () => viewer.copyCamera(),
    h: () => viewer.helper.showModal(), '?': () => viewer.helper.showModal(), p: () => viewer.panel.toggle(), ' ': () => viewer.switchMode('other'),
    s: () => viewer.switchMode('split'), a: () => viewer.switchMode('side'), d: () => viewer.switchMode('difference'),
    '+': closer, '=': closer, '-': () => view.zoom(1 / CLOSER),
    ...Object.fromEntries([0, 1, 2, 3, 4, 5].map((number) => [String(number + 1), () => viewer.lookFrom(number)])),
  };
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector('dialog[open]')) return;
    const {target, key} = event, isControl = target.closest?.(OWN), action = actions[key.toLowerCase()];
    if (target.closest?.(TYPED) || (isControl && (key in ARROWS || key === ' '))) return;
    if (!(key in ARROWS) && !action) return;
    event.preventDefault();
    const [right, up] = ARROWS[key] ?? [];
    if (key in ARROWS && event.shiftKey) view.pan(right * SHIFTED, up * SHIFTED);
    else if (key in ARROWS) view.turn(right * STEP, up * STEP);
    else if (!event.repeat || '+=-'.includes(key)) action();
  });
}

/** The page of help, closed. */
export function helpBox() {
  const rows = HELP.map(([keys, does]) => element('tr', {}, element('th', {scope: 'row'}, keys), element('td', {}, does)));
  const close = element('button', {type: 'button', textContent: 'Close', autofocus: true, on: {click: () => box.close()}});
  const box = element('dialog', {id: 'help', 'aria-label': 'Help'}, element('h2', {}, 'How to look'), element('table', {}, ...rows), close);
  box.addEventListener('click', (event) => { if (event.target === box) box.close(); });
  return box;
}
