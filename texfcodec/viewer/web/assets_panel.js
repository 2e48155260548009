// Names and figures of the assets, beside each other where there are two.

import { element } from './dom.js';
import { factsOf, fieldLines } from './facts.js';

const ORDINALS = ['First', 'Second'];

/** A section about what a viewer (of viewer.js) shows. */
export function assetsSection(viewer) {
  const slots = [0, 1].filter((slot) => viewer.headers[slot]), headers = slots.map((slot) => viewer.headers[slot]);
  const names = slots.map((slot) => nameOf(viewer.headers[slot], slots.length > 1 ? ORDINALS[slot] : ''));
  const problems = slots.map((slot) => viewer.problems[slot]).filter(Boolean);
  if (!slots.length) return element('section', {}, element('p', { className: 'faint' }, 'Nothing is open.'));
  return element('section', { className: 'assets' }, ...names,
    ...problems.map((text) => element('p', { className: 'problem' }, text)), factsTable(viewer, slots),
    ...headers.flatMap((header) => [
      folded('field', fieldLines(header), header, 2), folded('warning', header.warnings, header, 1),
    ]));
}

function nameOf({ name }, ordinal) {
  return element('h2', { title: name }, ordinal ? element('small', {}, ordinal) : null, name || 'without a name');
}

/** A row of each figure that an asset has, a column of each asset. */
function factsTable(viewer, slots) {
  const columns = slots.map((slot) => {
    const facts = factsOf(viewer.headers[slot], viewer.bytesOnGpu(slot));
    return new Map(facts.map((row) => [row.name, row]));
  });
  const names = [...new Set(columns.flatMap((column) => [...column.keys()]))];
  const rows = names.map((name) => {
    const title = columns.find((column) => column.has(name)).get(name).title ?? '';
    const cells = columns.map((column) => element('td', {}, column.get(name)?.text ?? '–'));
    return element('tr', { title }, element('th', { scope: 'row' }, name), ...cells);
  });
  const head = element('tr', {}, element('td'), ...slots.map((slot) => element('th', { scope: 'col' }, ORDINALS[slot])));
  return element('table', { className: 'facts' }, slots.length > 1 ? head : null, ...rows);
}

/** Lines that are shown when they are asked for; nothing where there are fewer than some. */
function folded(what, lines = [], { name }, fewest) {
  if (lines.length < fewest) return null;
  const title = `${lines.length} ${what}${lines.length > 1 ? 's' : ''} of ${name}`;
  return element('details', { className: 'rows' }, element('summary', {}, title),
    element('ul', {}, ...lines.map((line) => element('li', {}, line))));
}
