// Elements of the page in a line each, and the sentences that a person must see.

const BRIEF = 4000; // milliseconds that a passing remark stands
let passing = 0;

/** An element; properties are set as such, names with a dash as attributes, `on` holds listeners; children: nodes or text. */
export function element(tag, properties = {}, ...children) {
  const out = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === 'on') Object.entries(value).forEach(([kind, listener]) => out.addEventListener(kind, listener));
    else if (name.includes('-') || name === 'role') out.setAttribute(name, value);
    else out[name] = value;
  }
  out.append(...children.filter((child) => child !== null && child !== undefined));
  return out;
}

/** A labelled tick. */
export function tick(text, change) {
  const box = element('input', {type: 'checkbox', on: {change: () => change(box.checked)}});
  return {box, label: element('label', {className: 'tick'}, box, text)};
}

/** Puts a sentence where the user sees it, until another takes its place; an empty one takes it away. */
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
  const close = element('button', {type: 'button', textContent: '×', 'aria-label': 'Close', on: {click: () => say('')}});
  return element('p', {id: 'message', role: 'status', 'aria-live': 'polite'}, element('span'), close);
}
