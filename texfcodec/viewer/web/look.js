// What the page shows of its assets, and how it names that.

import { LAYERS } from './shaders.js';
import { HOTTEST } from './present.js';

export const BACKGROUNDS = { // of one colour, or of those of the top and of the bottom row
  Grey: [[150, 150, 150], [104, 104, 104]], White: [255, 255, 255], Light: [221, 223, 226], Middle: [128, 130, 134], Dark: [30, 32, 36], Black: [0, 0, 0],
};
const NOTHING = 'nothing'; // no layer's name: all of an asset is grey
const NO_TERMS = ['mask', 'blend', 'double_sided']; // effects that are no terms of shading

/** How the page shows its assets. start: how it is to begin (about.start), or nothing; search: the query of its address. */
export class Look {
  constructor(start, search) {
    const effects = new URLSearchParams(search).get('effects') ?? start?.effects;
    Object.assign(this, {
      mode: start?.mode ?? 'single', layer: start?.layer ?? 'picture', lit: Boolean(start?.shaded),
      isLightChosen: typeof start?.shaded === 'boolean',
      effects: effects === 'all' ? 'all' : 'scene',
      without: new Set(), slider: 0.5, hottest: HOTTEST,
      background: start?.background ?? BACKGROUNDS.Grey,
    });
  }

  /** Light for what would show its outline alone, unless somebody has chosen. */
  lightFor(header) {
    if (!this.isLightChosen) this.lit = needsLight(header);
  }

  /** The layer that is drawn of an asset: what it has not is grey. */
  layerOf(header) {
    return hasLayer(header, this.layer) ? this.layer : NOTHING;
  }
}

/** Whether a header's base colour shows no shape, and light would. */
export function needsLight(header) {
  return Boolean(header?.plain && header.light);
}

/** What the pictures of two assets are called: source and stream where that is what they are. */
export function halvesOf(headers) {
  const kinds = headers.map(({ kind }) => ({ mesh: 'source', stream: 'stream' })[kind]);
  const words = kinds[0] === kinds[1] ? ['first', 'second'] : kinds;
  return headers.map(({ name }, n) => `${words[n]}: ${name}`);
}

/** What the picture of a difference is called. */
export function differenceText(hottest) {
  return `difference: 0 to ${hottest} of 255, RMS of R, G, B`;
}

/** Names of the channels of an asset: of a stream's fields, of a mesh's maps. */
export function channelsOf(header) {
  if (header.kind === 'stream') return header.channels;
  const alpha = header.materials.some((material) => material.alpha_mode !== 0) ? ['alpha'] : [];
  return [...new Set(['base_colour', ...alpha, ...header.image_maps.flatMap(Object.keys)])];
}

/** Where the values of a field live; a network answers in place of the finest voxels. */
export function supportOf({ kind }) {
  return kind === 'latents' ? 'voxels' : kind;
}

export function hasLayer(header, layer) {
  if (layer === 'picture') return true;
  if (layer === 'cubes') return header.fields.some((field) => supportOf(field) === 'voxels');
  if (layer in LAYERS) return !LAYERS[layer].uv || 'uv0' in header.mesh.attributes;
  return channelsOf(header).includes(layer);
}

/** Layers of a list of headers, as groups of [key, text]. */
export function layersOf(headers) {
  const has = (layer) => headers.some((header) => hasLayer(header, layer));
  const channels = [...new Set(headers.flatMap(channelsOf))].map((name) => [name, worded(name)]);
  const others = [...Object.entries(LAYERS).map(([key, { text }]) => [key, text]), ['cubes', 'Voxels as cubes']];
  return { '': [['picture', 'Picture']], Channels: channels, Structure: others.filter(([key]) => has(key)) };
}

/** Terms of shading that the materials of assets use. */
export function termsOf(headers) {
  const used = new Set(headers.flatMap((header) => header.effects));
  return [...used].filter((name) => !NO_TERMS.includes(name)).sort((a, b) => (b === 'lit') - (a === 'lit') || a.localeCompare(b));
}

export function worded(name) {
  const text = name.replaceAll('_', ' ');
  return text[0].toUpperCase() + text.slice(1);
}
