// Fields on the GPU. Each has textures, and GLSL whose ask() sets f_CHANNEL, coded values in 0..1, for channels that are wanted.

import { BITS_GLSL, LEVELS_GLSL, lookUpGlsl, trilinearGlsl } from './glsl_voxels.js';
import { codeWords, networkBlock, networkGlsl } from './glsl_neural.js';
import { bilinearGlsl, DENSITY_GLSL, WRAP_GLSL } from './glsl_texels.js';
import { DeviceError, imageTexture, tableTexture } from './gl.js';
import { imageLevels, levelsOf, lookUpOf, pyramidOf, voxelsOf } from './supports.js';

const VECTORS = ['', 'float', 'vec2', 'vec3', 'vec4'];
const NETWORK_BINDING = 0;

/** A field of a header on the GPU. mesh: the header's; number: which field. */
export function uploadField(gl, header, number) {
  const field = header.fields[number];
  if (field.kind === 'images') return new ImageField(gl, header);
  if (field.kind === 'texels') return new TexelField(gl, field, number);
  return new VoxelField(gl, field, number, header);
}

/** Where every component of a plane's channels stands: channel -> "vec3(v0.xyz)" and the like. */
function swizzles(channels) {
  const out = new Map();
  let at = 0;
  for (const [name, count] of channels) {
    const parts = [...Array(count).keys()].map((k) => `v${(at + k) >> 2}.${'xyzw'[(at + k) & 3]}`);
    out.set(name, count === 1 ? parts[0] : `${VECTORS[count]}(${parts.join(', ')})`);
    at += count;
  }
  return out;
}

/** Values [rows * components] as arrays of four components a row. */
function foursomes(values, components) {
  const rows = values.length / components, textures = Math.ceil(components / 4);
  return [...Array(textures).keys()].map((t) => {
    const out = new Uint8Array(rows * 4), width = Math.min(4, components - 4 * t);
    for (let row = 0; row < rows; row++) {
      for (let c = 0; c < width; c++) out[4 * row + c] = values[row * components + 4 * t + c];
    }
    return out;
  });
}

class Field {
  /** planes: [{ channels, level }]; told: the header's field. */
  constructor(gl, told, number) {
    Object.assign(this, { gl, told, number, bytes: 0 });
    this.planes = told.planes.map(({ channels, level }) => {
      const components = channels.reduce((sum, [, count]) => sum + count, 0);
      return { channels, level, components, textures: Math.ceil(components / 4), places: swizzles(channels), kept: [] };
    });
    this.channels = this.planes.flatMap((plane) => plane.channels.map(([name]) => name));
  }

  /** Declarations of f_CHANNEL and the body of ask() for the planes that hold something wanted. */
  answers(wanted, asked) {
    const used = this.planes.filter((plane) => plane.channels.some(([name]) => wanted.has(name)));
    const names = used.flatMap((plane) => plane.channels.filter(([name]) => wanted.has(name)));
    const declared = names.map(([name, count]) => `${VECTORS[count]} f_${name};`).join('\n');
    const body = used.map((plane) => {
      const numbers = [...Array(plane.textures).keys()];
      const sets = plane.channels.filter(([name]) => wanted.has(name)).map(([name]) => `f_${name} = ${plane.places.get(name)};`);
      return `{ vec4 ${numbers.map((t) => `v${t}, w${t}`).join(', ')};\n${asked(plane, numbers)}\n${sets.join(' ')} }`;
    });
    return { used, declared, body: `void ask() {\n${body.join('\n')}\n}` };
  }

  /** Texture units in use after those of a program were bound from `unit` on. */
  bind(program, unit) {
    for (const plane of this.planes) {
      plane.kept.forEach((texture, t) => {
        const name = `u_values_${plane.level}_${t}`;
        if (program.place(name) !== null) program.texture(name, texture, unit++);
      });
    }
    return unit;
  }

  checkUnits(unit) {
    const most = this.gl.getParameter(this.gl.MAX_TEXTURE_IMAGE_UNITS);
    if (unit > most) throw new DeviceError(`A material asks for ${unit} textures at once; this device takes at most ${most}.`);
    return unit;
  }
}

/** Between the two levels around what a pixel covers: v of the finer, mixed with w of the coarser. */
function mixedLevels(plane, last, call, numbers) {
  const [v, w] = ['v', 'w'].map((letter) => numbers.map((t) => `${letter}${t}`).join(', '));
  return `float fineness = min(log2(max(wide, 1.0)), ${last});
  int level = int(fineness); float share = fineness - float(level);
  ${call('level', v)}
  if (share > 0.0) { ${call('level + 1', w)} ${numbers.map((t) => `v${t} = mix(v${t}, w${t}, share);`).join(' ')} }`;
}

export class VoxelField extends Field {
  constructor(gl, told, number, header) {
    super(gl, told, number);
    this.scale = told.grid_scale;
    this.perUnit = header.mesh.scale > 0 ? told.grid_scale / header.mesh.scale : 0;
    this.tree = levelsOf(told);
    this.places = new Map(); // of cubes, by level
    const { table, log2, bits } = lookUpOf(this.tree);
    const [tableKept, bitsKept] = [table, bits].map((rows) => tableTexture(gl, 'rg32ui', rows, 'A field'));
    this.lookUp = { table: tableKept, bits: bitsKept, log2 };
    this.bytes += table.byteLength + bits.byteLength;
    told.planes.forEach((one, i) => this.fill(this.planes[i], one));
    this.network = header.payload && told.kind === 'latents' ? new Network(gl, header, number) : null;
    if (this.network) this.bytes += this.network.bytes;
  }

  fill(plane, told) {
    const { values } = pyramidOf(told, plane.components, this.tree);
    plane.kept = foursomes(values, plane.components).map((rows) => tableTexture(this.gl, 'rgba8', rows, 'A field'));
    plane.base = this.tree.levels[plane.level - this.tree.first].base;
    this.bytes += values.length;
  }

  source(wanted) {
    const { depth, first } = this.told;
    const { used, declared, body } = this.answers(wanted, (plane, numbers) => {
      const own = this.network ? 0 : plane.level; // a network answers on level 0, which has no voxels here
      const call = (level, outs) => {
        const voxels = `voxels_${plane.level}(${own} + ${level}, grid / exp2(float(${level})), ${outs});`;
        return this.network ? `if (${level} == 0) { ${this.network.call(plane, outs)} } else { ${voxels} }` : voxels;
      };
      return `vec3 grid = v_position * (u_grid / ${2 ** own}.0);
  float wide = pixelWidth() * u_perUnit / ${2 ** own}.0;
  ${mixedLevels(plane, `${depth - own}.0`, call, numbers)}`;
    });
    const network = this.network && used.length ? this.network.source() : '';
    const planes = used.map((plane) => trilinearGlsl(plane.level, plane.textures)).join('');
    return `${BITS_GLSL}${lookUpGlsl('voxels')}${LEVELS_GLSL}const int FIRST = ${first};
uniform float u_grid, u_perUnit;
${planes}${network}${declared}
${body}`;
  }

  bind(program, unit) {
    program.texture('u_voxels_table', this.lookUp.table, unit++);
    program.texture('u_voxels_bits', this.lookUp.bits, unit++);
    program.setInteger('u_voxels_log2', this.lookUp.log2);
    program.setInteger('u_size', this.told.size);
    program.setInteger('u_last', this.told.depth);
    for (const plane of this.planes) program.setInteger(`u_base_${plane.level}`, plane.base);
    program.set({ u_grid: this.scale });
    const next = super.bind(program, unit);
    return this.checkUnits(this.network ? this.network.bind(program, next) : next);
  }

  /** GLSL of the network alone, for who gives places of its own. */
  probeSource() {
    return `${BITS_GLSL}${this.network.source()}`;
  }

  /**
   * What draws the voxels as cubes of at least a pixel, or of the finest level: places, values, the row of the first, how many,
   * and their side. wide: finest voxels to a pixel.
   */
  cubes(wide) {
    const { first, levels } = this.tree, [plane] = this.planes;
    const number = Math.min(Math.max(plane.level, Math.ceil(Math.log2(Math.max(wide, 1)))), first + levels.length - 1);
    const level = levels[number - first];
    if (!this.places.has(number)) {
      const xyz = voxelsOf(level), padded = new Uint16Array(level.count * 4);
      for (let i = 0; i < level.count; i++) padded.set(xyz.subarray(3 * i, 3 * i + 3), 4 * i);
      this.places.set(number, tableTexture(this.gl, 'rgb16ui', padded, 'The voxels'));
    }
    const side = 2 ** number / (this.scale || 1);
    return { places: this.places.get(number), values: plane.kept[0], row: level.base - plane.base, count: level.count, side };
  }
}

/** The payload that all fields of a 3DNTC stream ask, and one field's way into it. */
class Network {
  constructor(gl, header, number) {
    Object.assign(this, { gl, number, payload: header.payload, bytes: 0 });
    const told = header.fields[number];
    this.lookUps = told.latents.map((kept) => kept && this.lookUp(kept));
    if (!header.payload.uploaded) header.payload.uploaded = this.upload(header.payload);
    Object.assign(this, header.payload.uploaded);
  }

  lookUp(kept) {
    const { table, log2, bits } = lookUpOf(levelsOf({ ...kept, first: 0, depth: 0 }));
    this.bytes += table.byteLength + bits.byteLength;
    const [tableKept, bitsKept] = [table, bits].map((rows) => tableTexture(this.gl, 'rg32ui', rows, 'Latents'));
    return { table: tableKept, bits: bitsKept, log2 };
  }

  upload(payload) {
    const { gl } = this, words = codeWords(payload.codes, payload.rows, payload.features);
    const block = networkBlock(payload.network, payload.widths), most = gl.getParameter(gl.MAX_UNIFORM_BLOCK_SIZE);
    if (block.byteLength > most) {
      throw new DeviceError(`The network takes ${block.byteLength} bytes of uniforms; this device has room for ${most}.`);
    }
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, buffer);
    gl.bufferData(gl.UNIFORM_BUFFER, block, gl.STATIC_DRAW);
    return { codes: tableTexture(gl, 'r32ui', words, 'Latents'), block: buffer };
  }

  source() {
    const { position_bits: bits } = this.payload;
    return `${networkGlsl(this.payload, this.lookUps.map(Boolean))}
uniform float u_fine;
ivec3 finePosition() { return ivec3(floor(clamp(v_position * u_fine, 0.0, ${2 ** bits - 1}.0))); }
`;
  }

  /** GLSL that puts a plane's components into `outs`, "v0, v1", from the network's outputs. */
  call(plane, outs) {
    const outputs = Math.ceil(this.payload.widths.at(-1) / 4), names = [...Array(outputs).keys()].map((t) => `n${t}`);
    const columns = plane.channels.flatMap(([name]) => this.payload.outputs[name]);
    const sets = columns.map((from, to) => `${outs.split(', ')[to >> 2]}.${'xyzw'[to & 3]} = n${from >> 2}.${'xyzw'[from & 3]};`);
    return `vec4 ${names.join(', ')}; network(finePosition(), ${names.join(', ')}); ${sets.join(' ')}`;
  }

  bind(program, unit) {
    const { gl, payload, number } = this;
    program.texture('u_codes', this.codes, unit++);
    this.lookUps.forEach((kept, n) => {
      program.setInteger(`u_first_${n}`, payload.levels[n].first_rows[number]);
      if (kept === null) return;
      program.texture(`u_latents${n}_table`, kept.table, unit++);
      program.texture(`u_latents${n}_bits`, kept.bits, unit++);
      program.setInteger(`u_latents${n}_log2`, kept.log2);
    });
    program.set({ u_fine: payload.grid_scale });
    if (program.place('u_salt') !== null) gl.uniform1ui(program.place('u_salt'), payload.salts[number]);
    const index = gl.getUniformBlockIndex(program.handle, 'Network');
    if (index !== gl.INVALID_INDEX) gl.uniformBlockBinding(program.handle, index, NETWORK_BINDING);
    gl.bindBufferBase(gl.UNIFORM_BUFFER, NETWORK_BINDING, this.block);
    return unit;
  }
}

class TexelField extends Field {
  constructor(gl, told, number) {
    super(gl, told, number);
    told.planes.forEach((one, i) => {
      const plane = this.planes[i], [width, height] = one.size;
      const levels = imageLevels(one, [width, height], plane.components);
      const parts = [...Array(plane.textures).keys()];
      const split = levels.map((level) => foursomes(level.values, plane.components));
      plane.size = [width, height];
      plane.last = levels.length - 1;
      plane.kept = parts.map((t) => this.image('rgba8', levels, (_, n) => split[n][t]));
      plane.mask = this.image('r8', levels, (level) => level.mask);
    });
  }

  /** Levels in a texture whose sides are powers of two, or its levels would be a texel smaller than ours. */
  image(format, levels, valuesOf) {
    const side = (length) => 2 ** Math.ceil(Math.log2(length));
    const [width, height] = [side(levels[0].width), side(levels[0].height)];
    const components = format === 'r8' ? 1 : 4;
    const padded = levels.map((level, n) => {
      const [wide, high] = [Math.max(1, width >> n), Math.max(1, height >> n)], from = valuesOf(level, n);
      const values = new Uint8Array(wide * high * components);
      for (let y = 0; y < level.height; y++) {
        values.set(from.subarray(y * level.width * components, (y + 1) * level.width * components), y * wide * components);
      }
      this.bytes += values.length;
      return { width: wide, height: high, values };
    });
    return imageTexture(this.gl, format, padded, 'An image of the field');
  }

  source(wanted) {
    const { used, declared, body } = this.answers(wanted, (plane, numbers) => `vec2 texel = v_uv0;
  float wide = pixelWidth() * texelsPerUnit(texel) / exp2(float(u_shift_${plane.level}));
  ${mixedLevels(plane, `${plane.last}.0`, (level, outs) => `texels_${plane.level}(${level}, texel, ${outs});`, numbers)}`);
    return `uniform vec2 u_full;
uniform ivec2 u_wrap;
${WRAP_GLSL}${DENSITY_GLSL}${used.map((plane) => bilinearGlsl(plane.level, plane.textures)).join('')}${declared}
${body}`;
  }

  bind(program, unit) {
    program.set({ u_full: this.told.full_size });
    program.setInteger('u_wrap', ...this.told.wrap);
    for (const plane of this.planes) {
      program.setInteger(`u_size_${plane.level}`, ...plane.size);
      program.setInteger(`u_shift_${plane.level}`, this.told.shift + plane.level);
      if (program.place(`u_mask_${plane.level}`) !== null) program.texture(`u_mask_${plane.level}`, plane.mask, unit++);
    }
    return this.checkUnits(super.bind(program, unit));
  }
}

const WRAPS = ['REPEAT', 'CLAMP_TO_EDGE', 'MIRRORED_REPEAT'];

/** Images of a mesh, asked as a graphics library asks them. `material` is set before source() and bind(). */
class ImageField {
  constructor(gl, header) {
    Object.assign(this, { gl, header, number: 0, told: { kind: 'images' }, material: 0, bytes: 0 });
    this.images = header.images.map(({ values, wrap }) => this.upload(values, wrap));
    this.channels = [...new Set(['base_colour', 'alpha', ...header.image_maps.flatMap(Object.keys)])];
  }

  upload(values, wrap) {
    const { gl } = this, [height, width] = values.shape, levels = Math.floor(Math.log2(Math.max(width, height))) + 1;
    const first = { width, height, values }, texture = imageTexture(gl, 'rgba8', [first], 'An image of the mesh');
    gl.deleteTexture(texture);
    const out = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, out);
    gl.texStorage2D(gl.TEXTURE_2D, levels, gl.RGBA8, width, height);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, values);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl[WRAPS[wrap[0]]]);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl[WRAPS[wrap[1]]]);
    this.bytes += Math.round((width * height * 16) / 3);
    return { texture: out, width, height };
  }

  get maps() { return this.header.image_maps[this.material]; }

  source(wanted) {
    const coloured = 'colour' in this.header.mesh.attributes;
    const used = Object.entries(this.maps).filter(([name]) => wanted.has(name) || name === 'base_colour');
    const samplers = [...new Set(used.map(([, [image]]) => image))];
    const asks = used.filter(([name]) => name !== 'base_colour').map(([name, [image, uv, columns]]) => {
      const sampled = `sampled(u_image_${image}, v_uv${uv}, vec2(textureSize(u_image_${image}, 0)))`;
      if (name.endsWith('normal')) return [name, 2, `f_${name} = unitNormal(${sampled}.rgb);`];
      return [name, columns.length, `f_${name} = ${sampled}.${columns.map((c) => 'rgba'[c]).join('')};`];
    });
    const base = this.maps.base_colour;
    const image = base ? `sampled(u_image_${base[0]}, v_uv${base[1]}, vec2(textureSize(u_image_${base[0]}, 0)))` : 'vec4(1.0)';
    return `${DENSITY_GLSL}
${samplers.map((n) => `uniform sampler2D u_image_${n};`).join('\n')}
uniform vec4 u_factor;
vec3 f_base_colour;
float f_alpha;
${asks.map(([name, count]) => `${VECTORS[count]} f_${name};`).join('\n')}
vec4 sampled(sampler2D image, vec2 uv, vec2 size) {
  return textureLod(image, uv, log2(max(pixelWidth() * texelsPerUnit(uv * size), 1.0)));
}
vec2 unitNormal(vec3 coded) {
  vec3 n = coded * 2.0 - 1.0;
  n.z = max(n.z, 0.0);
  float size = length(n);
  return (size > 1e-3 ? n.xy / size : vec2(0.0)) * 0.5 + 0.5;
}
float linearOf(float c) { return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4); }
float codedOf(float c) { return c <= 0.0031308 ? c * 12.92 : 1.055 * pow(c, 1.0 / 2.4) - 0.055; }
void ask() {
  vec4 colour = ${image}, gain = u_factor${coloured ? ' * v_colour' : ''};
  for (int c = 0; c < 3; c++) {
    if (gain[c] != 1.0) colour[c] = codedOf(clamp(linearOf(colour[c]) * gain[c], 0.0, 1.0));
  }
  f_base_colour = colour.rgb;
  f_alpha = clamp(colour.a * gain.a, 0.0, 1.0);
  ${asks.map(([, , text]) => text).join('\n  ')}
}`;
  }

  bind(program, unit) {
    program.set({ u_factor: this.header.factors[this.material].factor });
    this.images.forEach(({ texture }, n) => {
      if (program.place(`u_image_${n}`) !== null) program.texture(`u_image_${n}`, texture, unit++);
    });
    return unit;
  }
}
