// What the page tells of an asset, in words and figures.

import { channelsOf, supportOf, worded } from './look.js';

const UNITS = ['B', 'kB', 'MB', 'GB'];
const LISTED = 3;
const ALPHA_MODES = ['opaque', 'mask', 'blend'];

export const grouped = (count) => count.toLocaleString('en-GB');

/** 91122 -> "91.1 kB". */
export function sizeText(bytes) {
  let at = 0;
  while (bytes >= 1000 && at + 1 < UNITS.length) [bytes, at] = [bytes / 1000, at + 1];
  return `${at ? bytes.toPrecision(3) : bytes} ${UNITS[at]}`;
}

/** Two decimals, or a word where the two are equal, or nothing is there to compare. */
export function decibelText(decibels) {
  if (Number.isNaN(decibels)) return '–';
  return decibels === Infinity ? 'equal' : decibels.toFixed(2);
}

export function timeText(milliseconds) {
  return milliseconds < 10 ? `${milliseconds.toFixed(1)} ms` : `${Math.round(milliseconds)} ms`;
}

/** Rows { name, text, title } about an asset. onGpu: bytes of its buffers and textures; null where it could not be uploaded. */
export function factsOf(header, onGpu) {
  const isStream = header.kind === 'stream', row = (name, text, title) => ({ name, text, title });
  return [
    row('Kind', isStream ? `TexF${header.payload ? ', 3DNTC' : ''}` : 'Mesh'),
    row('File', `${grouped(header.bytes)} B`),
    row('Resident', sizeText(header.resident), 'Decoded arrays, as they would be kept.'),
    row('On GPU', onGpu === null ? '–' : sizeText(onGpu), 'With coarser levels, and tables that find a place.'),
    row('Faces', grouped(header.faces)),
    ...(isStream ? supportsText(header.fields) : imagesText(header.images)).map(([name, text]) => row(name, text)),
    row('Channels', channelsOf(header).map((name) => worded(name).toLowerCase()).join(', ')),
    row('Materials', materialsText(header.materials)),
  ];
}

function materialsText(materials) {
  const modes = [...new Set(materials.map((material) => ALPHA_MODES[material.alpha_mode]))].filter((mode) => mode !== 'opaque');
  const sides = materials.some((material) => material.double_sided) ? ['double-sided'] : [];
  return [materials.length, ...modes, ...sides].join(', ');
}

/** How many voxels and texels the fields of a stream have, and their sizes. */
function supportsText(fields) {
  const rows = [...new Set(fields.map(supportOf))].map((kind) => {
    const own = fields.filter((field) => supportOf(field) === kind), sizes = [...new Set(own.map(sizeOf))];
    const count = own.reduce((sum, field) => sum + field.count, 0);
    return [[worded(kind), grouped(count)], [kind === 'voxels' ? 'K' : 'Size', listed(sizes)]];
  });
  return [['Fields', grouped(fields.length)], ...rows.flat()];
}

/** Of a field over voxels K, the side of its grid; of one over texels the size of its image. */
function sizeOf(field) {
  const sides = [].concat(field.size);
  return sides.join('×');
}

function imagesText(images) {
  const sizes = [...new Set(images.map(({ values }) => `${values.shape[1]}×${values.shape[0]}`))];
  return [['Images', images.length ? `${images.length}, ${listed(sizes)}` : 'none']];
}

function listed(texts) {
  return texts.slice(0, LISTED).join(', ') + (texts.length > LISTED ? ' …' : '');
}

/** A line about each field: its support, how large it is, what it holds. */
export function fieldLines(header) {
  if (header.kind !== 'stream') return [];
  return header.fields.map((field, number) => {
    const channels = field.planes.flatMap((plane) => plane.channels.map(([name]) => worded(name).toLowerCase()));
    return `${number}: ${grouped(field.count)} ${supportOf(field)}, ${sizeOf(field)}; ${channels.join(', ')}`;
  });
}
