// Elements of the page in a line each.

/** An element; properties are set as such, names with a dash as attributes, `on` holds listeners; children: nodes or text. */
export function element(tag, properties = {}, ...children) {
  const out = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === 'on') Object.entries(value).forEach(([kind, listener]) => out.addEventListener(kind, listener));
    else if (name.includes('-')) out.setAttribute(name, value);
    else out[name] = value;
  }
  out.append(...children.filter((child) => child !== null && child !== undefined));
  return out;
}

/** A labelled tick. */
export function tick(text, properties) {
  const box = element('input', { type: 'checkbox', ...properties });
  return { box, label: element('label', { className: 'tick' }, box, text) };
}
