/**
 * One decode, one instance of the WebAssembly module: its memory goes when the instance does.
 *
 * @typedef {object} Limits What a stream may ask for, clause 10 of the specification; 0 is no limit.
 * @property {number} [fileBytes]
 * @property {number} [vertices]
 * @property {number} [faces]
 * @property {number} [voxels] voxels and texels of all fields
 * @property {number} [texels] of one image
 * @property {number} [samples]
 * @property {number} [latents]
 * @property {number} [metadataBytes]
 *
 * @typedef {object} Material
 * @property {string} name
 * @property {'OPAQUE'|'MASK'|'BLEND'} alphaMode
 * @property {number} alphaCutoff 0 to 1
 * @property {boolean} doubleSided
 * @property {boolean} unlit
 * @property {boolean} flat whether every corner has the normal of its face
 * @property {Object<string, number[]>} parameters by name, those that differ from their default
 * @property {string[]} channels that it names
 *
 * @typedef {object} Unit Triangles of one material and one field.
 * @property {number} field
 * @property {number} material
 * @property {Float32Array} positions [vertices, 3], world, less `origin` of the asset
 * @property {Uint32Array} indices [faces, 3]
 * @property {Float32Array} normals [faces, 3 corners, 3]: shading normals
 * @property {Float32Array|null} uvs [vertices, 2] in images, v downwards; null over voxels
 * @property {Uint32Array} lattice [vertices, 3] positions as the stream has them, of `positionBits` bits
 * @property {Int32Array|null} texelSteps [vertices, 2] uvs as the stream has them, in texels times 2^`fractionBits` of the field
 *
 * @typedef {object} Field
 * @property {boolean} planar whether its values are on texels of an image, else on voxels
 * @property {number} resolution voxels along the longest side
 * @property {number} width
 * @property {number} height
 * @property {('repeat'|'clamp'|'mirror')[]} wrap
 * @property {number} fractionBits of texelSteps
 * @property {number} levelsLeftOut
 * @property {BigUint64Array} keys Morton keys
 * @property {Object<string, Plane>} planes by channel
 *
 * @typedef {object} Plane Values of a channel.
 * @property {Uint8Array} values [cells, components]
 * @property {number} components
 * @property {number} offset of the channel's first component among them
 * @property {number} levelShift how many levels coarser the cells are than the field's
 * @property {{width: number, height: number, data: Uint8Array}|null} image over texels, [height, width, components]
 *
 * @typedef {object} Neural What a shader needs to answer as a 3DNTC stream does, clause 11 of the specification.
 * @property {number} features of a row of latents
 * @property {number} octaves
 * @property {number} firstWave
 * @property {number[]} widths of the network's layers
 * @property {{resolution: number, log2: number, firstRows: number[], keys: BigUint64Array[]}[]} levels of latents; log2: of the rows of
 *   one table that all fields share, 0 where every field has a row for each of its keys
 * @property {Uint8Array} codes 4 bits a latent, two a byte, row after row
 * @property {Uint16Array} network binary16, weights and biases layer after layer
 * @property {Object<string, number[]>} outputs of the network by channel
 *
 * @typedef {object} Asset
 * @property {number[]} origin of the canonical cube
 * @property {number} side
 * @property {number} positionBits
 * @property {Material[]} materials
 * @property {Unit[]} units
 * @property {Field[]} fields
 * @property {Neural|null} neural of a 3DNTC stream
 * @property {object|null} metadata
 * @property {number[]} skipped types of units that were passed over
 */

/** A stream that is refused, or whose decoding was stopped. */
export class TexfError extends Error {
  /**
   * @param {'invalid'|'unsupported'|'limit'|'memory'|'aborted'|'network'|'internal'} code
   * @param {string} message one sentence
   * @param {{finding?: string, value?: number, allowed?: number}} details finding: code in docs/guide/errors.md, "TXF-S22"; value, allowed:
   *   what the stream has, and what it may have
   */
  constructor(code, message, details = {}) {
    super(message);
    this.name = 'TexfError';
    this.code = code;
    this.details = details;
  }
}

export const CHANNELS = ['base_colour', 'alpha', 'normal', 'normal_object', 'occlusion', 'roughness', 'metallic', 'emissive',
  'clearcoat', 'clearcoat_roughness', 'clearcoat_normal', 'clearcoat_normal_object', 'sheen_colour', 'sheen_roughness', 'specular',
  'specular_colour', 'transmission', 'thickness', 'iridescence', 'iridescence_thickness', 'anisotropy', 'diffuse_transmission',
  'diffuse_transmission_colour'];
const CHANNEL_COMPONENTS = [3, 1, 2, 3, 1, 1, 1, 3, 1, 1, 2, 3, 3, 1, 1, 3, 1, 1, 1, 1, 3, 1, 3];
const PARAMETERS = ['normal_scale', 'occlusion_strength', 'roughness', 'metallic', 'emissive', 'emissive_strength', 'clearcoat',
  'clearcoat_roughness', 'clearcoat_normal_scale', 'sheen_colour', 'sheen_roughness', 'specular', 'specular_colour', 'transmission',
  'thickness', 'attenuation_distance', 'attenuation_colour', 'iridescence', 'iridescence_ior', 'iridescence_thickness_minimum',
  'iridescence_thickness_maximum', 'anisotropy', 'anisotropy_rotation', 'diffuse_transmission', 'diffuse_transmission_colour', 'ior',
  'dispersion'];
const LIMITS = ['fileBytes', 'vertices', 'faces', 'voxels', 'texels', 'samples', 'latents', 'metadataBytes'];
const FAMILIES = /** @type {const} */ ({3: ['S', 'invalid'], 4: ['C', 'internal'], 5: ['U', 'unsupported'], 6: ['L', 'limit']});
const KIND = {description: 0, metadata: 1, positions: 2, uvs: 3, faces: 4, normals: 5, keys: 6, values: 7, sharpEdges: 8,
  codedNormals: 9, image: 10, latents: 11, network: 12, latentKeys: 13};

const CODED = 6; // the first normal_rule of clause 8.4.1 that takes normals from the stream

/** All attribute units. */
export const ALL = -1;

/** The arrays of a stream as the module gives them, for a single decode. */
export class Engine {
  /** @param {WebAssembly.Module} module */
  constructor(module) {
    const missing = () => 52, stop = () => { throw new WebAssembly.RuntimeError('the program has stopped'); };
    const environ = (/** @type {number} */ a, /** @type {number} */ b) => { // no variables
      new Uint32Array(this.exports.memory.buffer, a, 1)[0] = new Uint32Array(this.exports.memory.buffer, b, 1)[0] = 0;
      return 0;
    };
    // What the module's C library asks of a system: nothing is there.
    const system = {fd_close: missing, fd_seek: missing, fd_write: missing, environ_get: () => 0, environ_sizes_get: environ, proc_exit: stop};
    this.instance = new WebAssembly.Instance(module, {wasi_snapshot_preview1: system});
    this.exports = /** @type {any} */ (this.instance.exports);
    this.exports._initialize();
  }

  /**
   * @param {Uint8Array} bytes
   * @param {number} level levels of detail that are left out
   * @param {Limits} limits
   * @param {number} chosen a bit for every attribute unit that is decoded
   */
  decode(bytes, level = 0, limits = {}, chosen = ALL) {
    this.guarded(() => {
      const at = this.exports.limits(), view = new DataView(this.exports.memory.buffer);
      LIMITS.forEach((name, i) => {
        const limit = /** @type {any} */ (limits)[name];
        if (limit !== undefined) view.setBigUint64(at + 8 * i, BigInt(limit), true);
      });
      const fileBytes = Number(view.getBigUint64(at, true));
      if (fileBytes > 0 && bytes.length > fileBytes) throw new TexfError('limit', `the stream has ${bytes.length} bytes, the limit is ${fileBytes}`);
      const place = this.exports.allocate(bytes.length || 1);
      if (place === 0) throw new TexfError('memory', 'there is not enough memory for this stream');
      new Uint8Array(this.exports.memory.buffer, place, bytes.length).set(bytes);
      this.exports.decode_chosen(place, bytes.length, level, chosen);
    });
  }

  /** A copy of an array, empty where there is none.
   * @param {keyof typeof KIND} kind */
  array(kind, i = 0, j = 0) {
    return this.guarded(() => {
      const at = this.exports.array(KIND[kind], i, j) >>> 0, bytes = this.exports.array_bytes() >>> 0;
      return this.exports.memory.buffer.slice(at, at + (at ? bytes : 0));
    });
  }

  /** @template T @param {() => T} what @returns {T} */
  guarded(what) {
    try {
      return what();
    } catch (error) {
      if (error instanceof TexfError) throw error;
      const refusal = this.refusal();
      if (refusal) throw refusal;
      if (error instanceof WebAssembly.RuntimeError || error instanceof RangeError) throw new TexfError('memory', 'there is not enough memory for this stream');
      throw error;
    }
  }

  /** Why the program has stopped, texf_refusal of native/texf.h; null where it says nothing. */
  refusal() {
    const at = this.exports.refusal() >>> 0, view = new DataView(this.exports.memory.buffer, at), memory = new Uint8Array(view.buffer, at + 24);
    const number = view.getInt32(0, true), family = /** @type {keyof typeof FAMILIES} */ (Math.floor(number / 100));
    if (!(family in FAMILIES)) return null;
    const [letter, code] = FAMILIES[family], finding = `TXF-${letter}${String(number % 100).padStart(2, '0')}`;
    const [value, allowed] = [8, 16].map((place) => Number(view.getBigUint64(place, true)));
    const details = view.getInt32(4, true) ? {finding, value, allowed} : {finding};
    return new TexfError(code, new TextDecoder().decode(memory.slice(0, memory.indexOf(0))), details);
  }
}

/**
 * Decodes a stream, in this thread.
 *
 * @param {WebAssembly.Module} module
 * @param {Uint8Array} bytes
 * @param {number} level levels of detail that are left out
 * @param {Limits} limits
 * @param {number} chosen a bit for every attribute unit that is decoded; without the first one the asset has fields alone
 * @returns {Asset}
 */
export function decodeWith(module, bytes, level = 0, limits = {}, chosen = ALL) {
  const engine = new Engine(module);
  engine.decode(bytes, level, limits, chosen);
  const said = JSON.parse(new TextDecoder().decode(engine.array('description')));
  return {
    origin: said.origin,
    side: said.side,
    positionBits: said.position_bits,
    materials: said.materials.map(materialOf),
    units: chosen % 2 === 0 ? [] : said.units.map((/** @type {any} */ unit, /** @type {number} */ i) => unitOf(engine, said, unit, i)),
    fields: said.fields.map((/** @type {any} */ field, /** @type {number} */ i) => fieldOf(engine, said, field, i)),
    neural: neuralOf(engine, said),
    metadata: metadataOf(engine),
    skipped: said.skipped,
  };
}

/** @param {any} material @returns {Material} */
function materialOf(material) {
  const parameters = Object.entries(material.parameters).map(([id, value]) => [PARAMETERS[Number(id)], value]);
  return {
    name: material.name,
    alphaMode: /** @type {'OPAQUE'|'MASK'|'BLEND'} */ (['OPAQUE', 'MASK', 'BLEND'][material.alpha_mode]),
    alphaCutoff: material.alpha_cutoff / 65535,
    doubleSided: (material.flags & 1) > 0,
    unlit: (material.flags & 2) > 0,
    flat: material.normal_rule < CODED && material.normal_angle === 0,
    parameters: Object.fromEntries(parameters),
    channels: CHANNELS.filter((_, bit) => material.channels >> bit & 1),
  };
}

/** @param {Engine} engine @param {any} said @param {any} unit @param {number} i @returns {Unit} */
function unitOf(engine, said, unit, i) {
  const scale = said.side / (2 ** said.position_bits - 1), field = said.fields[unit.field];
  const lattice = new Uint32Array(engine.array('positions', i));
  const texelSteps = field?.planar ? new Int32Array(engine.array('uvs', i)) : null;
  return {
    field: unit.field,
    material: unit.material,
    positions: Float32Array.from(lattice, (p) => p * scale),
    indices: new Uint32Array(engine.array('faces', i)),
    normals: new Float32Array(engine.array('normals', i)),
    uvs: texelSteps && uvsOf(texelSteps, field),
    lattice,
    texelSteps,
  };
}

/** UVs of images as glTF and three.js (with flipY off) have them.
 * @param {Int32Array} steps @param {any} field */
function uvsOf(steps, field) {
  const u = field.width * 2 ** field.fraction_bits, v = field.height * 2 ** field.fraction_bits;
  return Float32Array.from(steps, (s, i) => i % 2 === 0 ? s / u : s / v);
}

/** @param {Engine} engine @param {any} said @param {any} field @param {number} i @returns {Field} */
function fieldOf(engine, said, field, i) {
  /** @type {Object<string, Plane>} */
  const planes = {};
  said.groups.forEach((/** @type {any} */ group, /** @type {number} */ g) => {
    const values = new Uint8Array(engine.array('values', i, g));
    if (values.length === 0) return;
    const shift = Math.max(field.levels_left_out, field.level_shift[g]), size = 2 ** shift;
    const image = !field.planar ? null
      : {width: Math.ceil(field.width / size), height: Math.ceil(field.height / size), data: new Uint8Array(engine.array('image', i, g))};
    let offset = 0;
    for (const semantic of group.semantics) {
      planes[CHANNELS[semantic]] = {values, components: group.components, offset, levelShift: field.level_shift[g], image};
      offset += CHANNEL_COMPONENTS[semantic];
    }
  });
  const wraps = /** @type {const} */ (['repeat', 'clamp', 'mirror']);
  return {planar: field.planar === 1, resolution: field.resolution, width: field.width, height: field.height,
    wrap: [wraps[field.wrap_s], wraps[field.wrap_t]], fractionBits: field.fraction_bits, levelsLeftOut: field.levels_left_out,
    keys: new BigUint64Array(engine.array('keys', i)), planes};
}

/** @param {Engine} engine @param {any} said @returns {Neural|null} */
function neuralOf(engine, {network, groups, fields}) {
  if (!network) return null;
  /** @type {Object<string, number[]>} */
  const outputs = {};
  let output = 0;
  for (const {semantics, components} of groups) {
    let offset = 0;
    for (const semantic of semantics) {
      const count = CHANNEL_COMPONENTS[semantic];
      outputs[CHANNELS[semantic]] = Array.from({length: count}, (_, c) => output + Math.min(offset + c, components - 1)); // grey: one for all
      offset += count;
    }
    output += components;
  }
  const levels = network.levels.map((/** @type {any} */ level, /** @type {number} */ n) => ({
    resolution: level.resolution, log2: level.log2,
    firstRows: fields.map((/** @type {any} */ _, /** @type {number} */ i) => level.first_rows[level.log2 > 0 ? 0 : i]),
    keys: level.log2 > 0 ? [] : fields.map((/** @type {any} */ _, /** @type {number} */ i) => new BigUint64Array(engine.array('latentKeys', i, n))),
  }));
  return {features: network.features, octaves: network.octaves, firstWave: network.first_wave, widths: network.widths, levels, outputs,
    codes: new Uint8Array(engine.array('latents')), network: new Uint16Array(engine.array('network'))};
}

/** @param {Engine} engine */
function metadataOf(engine) {
  try {
    return JSON.parse(new TextDecoder().decode(engine.array('metadata')));
  } catch {
    return null; // no stream is refused for what stands there (5.8)
  }
}
