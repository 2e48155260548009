// What the page tells of an asset, in words and figures.

import { channelsOf, worded } from './look.js';

const KINDS = { voxels: 'voxels', neural: 'voxels', texels: 'texels', images: 'images' };
const SIZES = ['bytes', 'kB', 'MB', 'GB'];
const ALPHA_MODES = ['opaque', 'mask', 'blend'];

export const grouped = (count) => count.toLocaleString('en-GB');

/** 91122 -> "91.1 kB". */
export function sizeText(bytes) {
  let at = 0;
  while (bytes >= 1000 && at + 1 < SIZES.length) [bytes, at] = [bytes / 1000, at + 1];
  return `${at ? bytes.toPrecision(3) : bytes} ${SIZES[at]}`;
}

export function decibelText(decibels) {
  if (Number.isNaN(decibels)) return '–';
  return decibels === Infinity ? 'equal' : `${decibels.toFixed(2)} dB`;
}

export function timeText(milliseconds) {
  return milliseconds < 10 ? `${milliseconds.toFixed(1)} ms` : `${Math.round(milliseconds)} ms`;
}

/** Rows [name, text] about an asset. onGpu: bytes of its buffers and textures, or null where it could not be uploaded. */
export function factsOf(header, onGpu) {
  const isStream = header.kind === 'stream', { alpha, sides } = materialsText(header.materials);
  return [
    ['Kind', isStream ? `TexF stream${header.payload ? ', 3DNTC' : ''}` : 'Mesh with images'],
    ['File', `${sizeText(header.bytes)} (${grouped(header.bytes)} bytes)`],
    ['Resident', `${sizeText(header.resident)}${onGpu === null ? '' : `; ${sizeText(onGpu)} with levels and tables`}`],
    ['Faces', grouped(header.faces)],
    ...(isStream ? supportsText(header.fields) : imagesText(header.images)),
    ['Channels', channelsOf(header).map((name) => worded(name).toLowerCase()).join(', ')],
    ['Materials', [header.materials.length, alpha, sides].filter(Boolean).join(', ')],
  ];
}

function materialsText(materials) {
  const modes = [...new Set(materials.map((material) => ALPHA_MODES[material.alpha_mode]))].filter((mode) => mode !== 'opaque');
  return { alpha: modes.join(' and '), sides: materials.some((material) => material.double_sided) ? 'double-sided' : '' };
}

/** How many voxels and texels the fields of a stream have, and their sizes. */
function supportsText(fields) {
  const rows = [...new Set(fields.map((field) => KINDS[field.kind]))].map((kind) => {
    const own = fields.filter((field) => KINDS[field.kind] === kind), sizes = [...new Set(own.map((field) => sizeOf(field)))];
    const listed = sizes.slice(0, 3).join(', ') + (sizes.length > 3 ? ' …' : '');
    return [worded(kind), `${grouped(own.reduce((sum, field) => sum + field.count, 0))}, ${kind === 'voxels' ? 'K = ' : ''}${listed}`];
  });
  return [['Fields', grouped(fields.length)], ...rows];
}

/** Of a field over voxels K, the side of its grid; of one over texels the size of its image. */
function sizeOf(field) {
  const sides = [].concat(field.size);
  return sides.join(' × ');
}

function imagesText(images) {
  const sizes = images.map(({ values }) => `${values.shape[1]} × ${values.shape[0]}`), kinds = [...new Set(sizes)];
  return [['Images', images.length ? `${images.length}, ${kinds.slice(0, 3).join(', ')}${kinds.length > 3 ? ' …' : ''}` : 'none']];
}

/** A line about each field: its support, how large it is, what it holds. */
export function fieldLines(header) {
  if (header.kind !== 'stream') return [];
  return header.fields.map((field, number) => {
    const channels = field.planes.flatMap((plane) => plane.channels.map(([name]) => worded(name).toLowerCase()));
    return `${number}: ${grouped(field.count)} ${KINDS[field.kind]}, ${sizeOf(field)}; ${channels.join(', ')}`;
  });
}
