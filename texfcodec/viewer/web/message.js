// Sentences that a person must see.

import { element } from './dom.js';

const BRIEF = 4000; // milliseconds that a passing remark stands

let passing = 0;

/** Puts a sentence where the user sees it, until it is taken away or another takes its place; an empty one takes it away. */
export function say(text) {
  clearTimeout(passing);
  const box = document.getElementById('message') ?? document.body.appendChild(messageBox());
  box.querySelector('span').textContent = text;
  box.hidden = !text;
}

/** A sentence that goes away by itself. */
export function mention(text) {
  say(text);
  passing = setTimeout(() => say(''), BRIEF);
}

function messageBox() {
  const close = element('button', { type: 'button', textContent: '×', 'aria-label': 'Close', on: { click: () => say('') } });
  return element('p', { id: 'message', role: 'status', 'aria-live': 'polite' }, element('span'), close);
}
