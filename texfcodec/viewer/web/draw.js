// An asset on the GPU, and pictures of it.

import { uploadField } from './fields.js';
import { ATTRIBUTES, DeviceError, Program, Target } from './gl.js';
import { fragmentSource, LAYERS, VERTEX } from './shaders.js';
import { setShading } from './shading.js';

const LAYERS_DEEP = 8; // of what is seen through; what lies behind the eighth is not seen
const OPAQUE = 0, BLEND = 2;
const PALETTE = [[0.3, 0.55, 0.9], [0.95, 0.6, 0.2], [0.35, 0.75, 0.4], [0.85, 0.35, 0.4], [0.6, 0.45, 0.8], [0.55, 0.55, 0.5]];
const SUPPORT_COLOURS = { voxels: PALETTE[0], texels: PALETTE[1], latents: PALETTE[2], images: PALETTE[5] };
const SIZES = { position: [3, 'FLOAT'], normal: [2, 'SHORT'], tangent: [4, 'SHORT'], colour: [4, 'FLOAT'] };

/** An unpacked container, uploaded. Throws a DeviceError for what the device cannot hold. */
export class Asset {
  constructor(gl, header) {
    Object.assign(this, { gl, header, texts: new Map(), programs: new Map(), bytes: 0 });
    this.fields = header.fields.map((_, number) => uploadField(gl, header, number));
    this.bytes += this.fields.reduce((sum, field) => sum + field.bytes, 0);
    this.vertices = this.upload(header.mesh);
  }

  upload(mesh) {
    const { gl } = this, vertices = gl.createVertexArray();
    gl.bindVertexArray(vertices);
    this.attribute('position', Float32Array.from(mesh.positions));
    for (const [name, array] of Object.entries(mesh.attributes)) this.attribute(name, array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.bytes += mesh.faces.byteLength;
    return vertices;
  }

  attribute(name, array) {
    const { gl } = this, place = ATTRIBUTES.indexOf(`a_${name}`), [size, type] = SIZES[name] ?? [2, 'FLOAT'];
    if (place < 0) throw new DeviceError('The mesh has more than four sets of UVs.');
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl[type], type === 'SHORT', 0, 0);
    this.bytes += array.byteLength;
  }

  /** Whether something is mixed with what lies behind it. */
  get blends() {
    return this.header.mesh.parts.some(([, , , material]) => this.header.materials[material].alpha_mode === BLEND);
  }

  /** Effects of all materials that are drawn. */
  get effects() {
    return [...new Set(this.header.mesh.parts.flatMap(([, , , m]) => this.header.materials[m].effects))].sort();
  }

  /** Where the asset's own positions are, in radii from another header's centre: [x, y, z, scale]. */
  placeIn(other) {
    const { centre, radius, mesh } = this.header, ratio = radius / other.radius;
    return [...mesh.offset.map((o, i) => o * ratio + (centre[i] - other.centre[i]) / other.radius), mesh.scale * ratio];
  }

  /** Another header's radius in this asset's. */
  unitsOf(other) {
    return other.radius / this.header.radius;
  }

  /** Radius about another header's centre, in its radii, that holds all of this asset. */
  reachIn(other) {
    const { centre, radius } = this.header;
    return (Math.hypot(...centre.map((c, i) => c - other.centre[i])) + radius) / other.radius;
  }

  /** The program of a part's field and material; shared by all that look alike. */
  program(field, material, options) {
    if (field.told.kind === 'images') field.material = this.header.materials.indexOf(material);
    const look = lookOf(material, options, this.header.defaults);
    const key = JSON.stringify([field.told.kind === 'images' ? field.material : field.number, look.effects, look.maps,
      Object.keys(look.parameters), look.alpha_mode, options.layer, options.lit, options.peels]);
    const { attributes } = this.header.mesh;
    if (!this.texts.has(key)) this.texts.set(key, fragmentSource({ ...options, field, material: look, attributes }));
    const fragment = this.texts.get(key);
    if (!this.programs.has(fragment)) this.programs.set(fragment, new Program(this.gl, VERTEX(attributes), fragment));
    return [this.programs.get(fragment), look];
  }
}

/** A material with the effects that are to be shown: all that there are, or its own without some. */
function lookOf(material, { effects, without = [] }, defaults) {
  if (effects === 'all' && material.effects.includes('lit')) {
    return { ...material, effects: defaults.effects, parameters: { ...defaults.parameters, ...material.parameters } };
  }
  return without.length ? { ...material, effects: material.effects.filter((name) => !without.includes(name)) } : material;
}

/** Draws assets into Targets. */
export class Painter {
  constructor(gl) {
    this.gl = gl;
    this.spare = null;
  }

  /**
   * A picture of an asset, premultiplied, into a Target. camera: of Orbit.camera(); options: { lit, layer, effects: 'scene' or
   * 'all', without: effects left out, atOnce: for few pixels, no depths before the colours };
   * home: the header whose centre and radius the camera is in.
   */
  draw(asset, camera, target, options, home = asset.header) {
    const { gl } = this;
    if (asset.blends && ['picture', 'base_colour'].includes(options.layer)) {
      this.peel(asset, camera, target, options, home);
      return;
    }
    target.bind();
    this.clear();
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    if (options.layer === 'cubes') this.cubes(asset, camera, home);
    else this.solid(asset, camera, options, home);
    gl.bindVertexArray(null);
  }

  /** What is not seen through; or, of a layer that shows no alpha, everything. */
  solid(asset, camera, options, home, chosen = () => true) {
    if (!options.atOnce) this.depths(asset, camera, home);
    this.parts(asset, camera, { ...options, peels: false }, home, chosen);
  }

  clear() {
    const { gl } = this;
    gl.clearColor(0, 0, 0, 0);
    gl.clearDepth(1);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  /** Draws parts whose material is chosen. textures: by name, of what a program reads beside its field and terms. */
  parts(asset, camera, options, home, chosen, textures = {}) {
    const { gl } = this, { header } = asset;
    gl.bindVertexArray(asset.vertices);
    for (const [first, count, number, m] of header.mesh.parts) {
      if (!chosen(header.materials[m])) continue;
      const field = asset.fields[number], [program, look] = asset.program(field, header.materials[m], options);
      gl.useProgram(program.handle);
      gl[look.double_sided ? 'disable' : 'enable'](gl.CULL_FACE);
      let unit = 0;
      for (const [name, texture] of Object.entries(textures)) program.texture(name, texture, unit++);
      if (look.effects.includes('lit') && (options.lit || LAYERS[options.layer]?.normal)) {
        unit = setShading(gl, program.handle, header.light, look, unit);
      }
      field.bind(program, unit);
      this.settle(program, camera, asset.placeIn(home), look);
      program.set({ u_flat: flatColour(options.layer, field, number), u_cells: cellsOf(field, header) * asset.unitsOf(home) });
      if (field.perUnit) program.set({ u_perUnit: field.perUnit * asset.unitsOf(home) });
      gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 12 * first);
    }
  }

  /** Depth first, of what is opaque: a fragment that is hidden asks nothing. */
  depths(asset, camera, home) {
    const { gl } = this, { header } = asset;
    this.deepener ??= new Program(gl, VERTEX({}), '#version 300 es\nprecision highp float;\nvoid main() {}');
    gl.useProgram(this.deepener.handle);
    gl.bindVertexArray(asset.vertices);
    gl.colorMask(false, false, false, false);
    this.settle(this.deepener, camera, asset.placeIn(home), { alpha_cutoff: 0 });
    for (const [first, count, , m] of header.mesh.parts) {
      if (header.materials[m].alpha_mode !== OPAQUE) continue;
      gl[header.materials[m].double_sided ? 'disable' : 'enable'](gl.CULL_FACE);
      gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 12 * first);
    }
    gl.colorMask(true, true, true, true);
  }

  settle(program, camera, place, look) {
    const { gl } = this;
    gl.uniformMatrix4fv(program.place('u_camera'), false, camera.matrix);
    const { eye, forward, pixel } = camera;
    program.set({ u_place: place, u_eye: eye, u_forward: forward, u_pixel: pixel, u_cutoff: look.alpha_cutoff });
    program.setInteger('u_perspective', camera.perspective ? 1 : 0);
  }

  /**
   * What is seen through front to back, a pass for each layer, as render/depth_layers.py does, and behind it what is not; coded colours
   * are mixed.
   */
  peel(asset, camera, target, options, home) {
    const { gl } = this, [solid, a, b] = this.layers(target.width, target.height);
    solid.bind();
    this.clear();
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    this.solid(asset, camera, options, home, (material) => material.alpha_mode !== BLEND);
    target.bind();
    this.clear();
    for (let layer = 0; layer < LAYERS_DEEP; layer++) {
      const [to, from] = layer % 2 ? [b, a] : [a, b];
      to.bind();
      this.clear();
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LEQUAL);
      gl.disable(gl.BLEND);
      const textures = layer > 0 ? { u_solid: solid.depth, u_before: from.depth } : { u_solid: solid.depth };
      const isSeenThrough = (material) => material.alpha_mode === BLEND;
      this.parts(asset, camera, { ...options, peels: layer > 0 ? 2 : 1 }, home, isSeenThrough, textures);
      this.under(target, to);
    }
    this.under(target, solid);
    gl.bindVertexArray(null);
  }

  /** Puts a picture under what a target shows. */
  under(target, picture) {
    const { gl } = this;
    target.bind();
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
    this.copy(picture.colour);
    gl.disable(gl.BLEND);
  }

  layers(width, height) {
    if (!this.spare || this.spare[0].width !== width || this.spare[0].height !== height) {
      this.spare?.forEach((one) => one.free());
      this.spare = [0, 1, 2].map(() => new Target(this.gl, width, height));
    }
    return this.spare;
  }

  copy(texture) {
    this.copier ??= new Program(this.gl, SCREEN, `#version 300 es
precision highp float;
uniform sampler2D u_picture;
out vec4 o_colour;
void main() { o_colour = texelFetch(u_picture, ivec2(gl_FragCoord.xy), 0); }`);
    this.gl.useProgram(this.copier.handle);
    this.copier.texture('u_picture', texture, 0);
    this.gl.bindVertexArray(null);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  /** Voxels of every field over voxels as cubes, an instance each. */
  cubes(asset, camera, home) {
    const { gl } = this;
    this.cuber ??= new Program(gl, CUBES, CUBE_FRAGMENT);
    gl.useProgram(this.cuber.handle);
    gl.enable(gl.CULL_FACE);
    gl.bindVertexArray(null);
    for (const field of asset.fields.filter((one) => one.cubes)) {
      const depth = camera.perspective ? Math.hypot(...camera.eye) : 1;
      const wide = camera.pixel * depth * field.perUnit * asset.unitsOf(home);
      const { places, values, row, count, side } = field.cubes(wide);
      this.settle(this.cuber, camera, asset.placeIn(home), { alpha_cutoff: 0 });
      this.cuber.set({ u_side: side });
      this.cuber.setInteger('u_row', row);
      this.cuber.texture('u_places', places, 0);
      this.cuber.texture('u_values', values, 1);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, 36, count);
    }
  }
}

/** A triangle that covers the picture. */
export const SCREEN = `#version 300 es
void main() { gl_Position = vec4(float((gl_VertexID & 1) * 4 - 1), float((gl_VertexID >> 1) * 4 - 1), 0.0, 1.0); }`;

const CUBES = `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D u_places;
uniform sampler2D u_values;
uniform mat4 u_camera;
uniform vec4 u_place;
uniform float u_side;
uniform int u_row;
flat out vec3 v_colour;
void main() {
  ivec2 at = ivec2(gl_InstanceID & 2047, gl_InstanceID >> 11);
  int face = gl_VertexID / 6, axis = face >> 1, corner = gl_VertexID % 6;
  vec2 uv = vec2(corner == 1 || corner == 3 || corner == 4, corner == 2 || corner == 4 || corner == 5);
  bool far = (face & 1) == 1;
  if (!far) uv = uv.yx;
  vec3 place;
  place[axis] = far ? 1.0 : 0.0;
  place[(axis + 1) % 3] = uv.x;
  place[(axis + 2) % 3] = uv.y;
  vec3 position = (vec3(texelFetch(u_places, at, 0).xyz) + place) * u_side;
  int row = u_row + gl_InstanceID;
  v_colour = texelFetch(u_values, ivec2(row & 2047, row >> 11), 0).rgb * (axis == 1 ? 1.0 : axis == 0 ? 0.92 : 0.84);
  gl_Position = u_camera * vec4(position * u_place.w + u_place.xyz, 1.0);
}`;

const CUBE_FRAGMENT = `#version 300 es
precision highp float;
flat in vec3 v_colour;
out vec4 o_colour;
void main() { o_colour = vec4(v_colour, 1.0); }`;

/** Voxels of a field along one radius; those of a grid of 1024 where it has none. */
function cellsOf(field, header) {
  if (field.perUnit) return field.perUnit;
  const grids = header.fields.filter((one) => one.grid_scale);
  return grids.length && header.mesh.scale ? grids[0].grid_scale / header.mesh.scale : 512;
}

function flatColour(layer, field, number) {
  return layer === 'supports' ? SUPPORT_COLOURS[field.told.kind] : PALETTE[number % PALETTE.length];
}
