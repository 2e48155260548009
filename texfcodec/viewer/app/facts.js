// What the page tells of an asset, in words and figures.

import {worded} from './shown_layers.js';

const LISTED = 3;
const listed = (texts) => [...new Set(texts)].slice(0, LISTED).join(', ') + (new Set(texts).size > LISTED ? ' …' : '');

export const grouped = (count) => count.toLocaleString('en-GB');

/** Two decimals, or a word if the two are equal, or nothing is there to compare. */
export function decibelText(decibels) {
  if (Number.isNaN(decibels)) return '–';
  return decibels === Infinity ? 'equal' : decibels.toFixed(2);
}

export function timeText(milliseconds) {
  return milliseconds < 10 ? `${milliseconds.toFixed(1)} ms` : `${Math.round(milliseconds)} ms`;
}

/** Rows [name, text] about an asset (asset.js). */
export function factsOf(asset) {
  const {stream, meshes} = asset, faces = meshes.reduce((sum, {geometry: {index, attributes}}) => sum + (index ?? attributes.position).count / 3, 0);
  return [
    ['Kind', stream ? `TexF${stream.userData.isNeural ? ', 3DNTC' : ''}` : 'Mesh'],
    ['File', `${grouped(asset.bytes)} B`],
    ['Faces', grouped(faces)],
    ...(stream ? supportsText(stream.userData.fields) : imagesText(asset.textures)),
    ['Channels', asset.channels.map((name) => worded(name).toLowerCase()).join(', ')],
    ['Materials', materialsText(asset.materials)],
  ];
}

function materialsText(materials) {
  const has = (text, test) => (materials.some(test) ? [text] : []);
  return [materials.length, ...has('mask', ({alphaTest}) => alphaTest > 0), ...has('blend', ({transparent}) => transparent), ...has('double-sided', ({side}) => side === 2)].join(', ');
}

/** How many voxels and texels the fields of a stream have, and their sizes. */
function supportsText(fields) {
  const rows = [['Voxels', 'K', false], ['Texels', 'Size', true]].flatMap(([name, sizes, isPlanar]) => {
    const own = fields.filter(({planar}) => planar === isPlanar), count = own.reduce((sum, {cells}) => sum + cells, 0);
    return own.length ? [[name, grouped(count)], [sizes, listed(own.map(({size}) => size.join('×')))]] : [];
  });
  return [['Fields', grouped(fields.length)], ...rows];
}

function imagesText(textures) {
  const images = [...new Set(textures.map(({source}) => source.data))].filter(Boolean);
  return [['Images', images.length ? `${images.length}, ${listed(images.map(({width, height}) => `${width}×${height}`))}` : 'none']];
}
