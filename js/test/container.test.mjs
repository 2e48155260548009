/** The part-level form of TEXF_stream in node: GLBs made here of a vector's stream, through expand() and through the plug-in. */

import assert from 'node:assert/strict';
import {spawnSync} from 'node:child_process';
import {readFileSync, readdirSync} from 'node:fs';
import {test} from 'node:test';
import {deflateSync, inflateSync} from 'node:zlib';

import {Atlas} from '../src/atlas.js';
import {expand} from '../src/gltf.js';
import {TexfError, decode, dispose} from '../src/index.js';

const three = await import('three/addons/loaders/GLTFLoader.js').catch(() => null); // npm install three
const {TEXFStreamExtension} = await import('../src/gltf.js');
const unless = {skip: three ? false : 'three is not installed'};
const read = (name) => readFileSync(new URL(`../../conformance/${name}/in.texf`, import.meta.url));
const stream = read('subset/texels'), asset = await decode(stream), [unit] = asset.units, count = unit.positions.length / 3;
const MATRIX = [0, 2, 0, 0, 2, 0, 0, 0, 0, 0, 2, 0, 5, 6, 7, 1]; // mirrors

/** zlib data of rows of bytes, as the extension has it. */
function deflated(values, row) {
  const bytes = new Uint8Array(values.buffer), rows = bytes.length / row;
  return deflateSync(Uint8Array.from(bytes, (_, i) => bytes[i % rows * row + Math.floor(i / rows)] - (i % rows ? bytes[(i % rows - 1) * row + Math.floor(i / rows)] : 0)));
}

/** A GLB of a skinned primitive that is the vector's first unit. change(root): makes it another. */
function coded(change = () => {}, bytes = stream) {
  const joints = Uint8Array.from({length: 4 * (count + 1)}, (_, i) => i % 4 ? 0 : i / 4 & 1), weights = Float32Array.from({length: 4 * (count + 1)}, (_, i) => i % 4 ? 0 : 1);
  const splits = Uint32Array.from([4, count]), pieces = [bytes, deflated(joints, 4), deflated(weights, 16), new Uint8Array(splits.buffer)];
  const places = pieces.map((_, n) => pieces.slice(0, n).reduce((sum, piece) => sum + piece.length + (-piece.length & 3), 0)), length = places.at(-1) + 8;
  const packed = (n, size, row) => ({buffer: 1, byteOffset: 0, byteLength: size, extensions: {TEXF_stream: {buffer: 0, byteOffset: places[n], byteLength: pieces[n].length, row}}});
  const root = {
    asset: {version: '2.0'}, extensionsUsed: ['TEXF_stream'], extensionsRequired: ['TEXF_stream'], extensions: {TEXF_stream: {streams: [0]}},
    scene: 0, scenes: [{nodes: [0, 1, 2]}], nodes: [{mesh: 0, skin: 0, name: 'body'}, {name: 'left'}, {name: 'right'}], skins: [{joints: [1, 2]}],
    meshes: [{name: 'body', primitives: [{attributes: {POSITION: 0, NORMAL: 0, TEXCOORD_0: 1, JOINTS_0: 2, WEIGHTS_0: 3}, indices: 4, material: 0,
      extensions: {TEXF_stream: {stream: 0, units: [0], matrix: MATRIX, splits: 5}}}]}],
    materials: [{name: 'skin', doubleSided: true, pbrMetallicRoughness: {roughnessFactor: 0.25, baseColorTexture: {index: 0, texCoord: 3, extensions: {KHR_texture_transform: {scale: [2, 2]}}}}}],
    textures: [{}], buffers: [{byteLength: length}, {byteLength: 20 * (count + 1), extensions: {TEXF_stream: {fallback: true}}}],
    accessors: [{componentType: 5126, count: count + 1, type: 'VEC3', min: [0, 0, 0], max: [1, 1, 1]}, {componentType: 5126, count: count + 1, type: 'VEC2'},
      {bufferView: 1, componentType: 5121, count: count + 1, type: 'VEC4'}, {bufferView: 2, componentType: 5126, count: count + 1, type: 'VEC4'},
      {componentType: 5125, count: unit.indices.length, type: 'SCALAR'}, {bufferView: 3, componentType: 5125, count: 1, type: 'VEC2'}],
    bufferViews: [{buffer: 0, byteLength: bytes.length}, packed(1, joints.length, 4), packed(2, weights.byteLength, 16), {buffer: 0, byteOffset: places[3], byteLength: 8}],
  };
  change(root);
  const chunk = (kind, data) => Buffer.concat([Buffer.from(new Uint32Array([data.length, kind]).buffer), data]), text = JSON.stringify(root);
  const whole = Buffer.alloc(length);
  pieces.forEach((piece, n) => whole.set(piece, places[n]));
  const body = Buffer.concat([chunk(0x4E4F534A, Buffer.from(text.padEnd(text.length + 3 & ~3))), chunk(0x004E4942, whole)]);
  const file = Buffer.concat([Buffer.from('glTF'), Buffer.from(new Uint32Array([2, 12 + body.length]).buffer), body]);
  return file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
}

/** The tree of a GLB and a function that reads an accessor, rows of plain float32, uint16 or uint8. */
function opened(file) {
  const length = new DataView(file).getUint32(12, true), root = JSON.parse(new TextDecoder().decode(new Uint8Array(file, 20, length)));
  const bytes = (view) => file.slice(28 + length + root.bufferViews[view].byteOffset, 28 + length + root.bufferViews[view].byteOffset + root.bufferViews[view].byteLength);
  const rows = (number) => {
    const {componentType, type, bufferView} = root.accessors[number], Kind = {5121: Uint8Array, 5123: Uint16Array, 5126: Float32Array}[componentType];
    const values = new Kind(bytes(bufferView)), width = {SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4}[type];
    return Array.from({length: values.length / width}, (_, i) => [...values.subarray(i * width, (i + 1) * width)]);
  };
  return {root, bytes, rows};
}

test('expand() gives an ordinary file: geometry in mesh space, stored attributes by their vertices, an image', async () => {
  const {root, bytes, rows} = opened(await expand(coded())), [{attributes, indices, extensions}] = root.meshes[0].primitives;
  assert.deepEqual([root.extensions, root.extensionsUsed, extensions], [undefined, undefined, undefined]);
  const index = rows(indices).flat(), joints = rows(attributes.JOINTS_0), positions = rows(attributes.POSITION), uvs = rows(attributes.TEXCOORD_0);
  assert.equal(index.length, unit.indices.length);
  for (let i = 0; i < index.length; i++) {
    const corner = [i, i + 1, i - 1][i % 3], vertex = unit.indices[corner], [x, y, z] = [0, 1, 2].map((k) => asset.origin[k] + unit.positions[3 * vertex + k]);
    assert.deepEqual(joints[index[i]], [corner === 4 ? count & 1 : vertex & 1, 0, 0, 0]);
    [2 * y + 5, 2 * x + 6, 2 * z + 7].forEach((value, k) => assert.ok(Math.abs(positions[index[i]][k] - value) < 1e-4));
    assert.deepEqual(uvs[index[i]], [...unit.uvs.subarray(2 * vertex, 2 * vertex + 2)]);
  }
  assert.deepEqual(root.materials[0], {name: 'skin', doubleSided: true, pbrMetallicRoughness: {roughnessFactor: 0.25, baseColorTexture: {index: 0}}});
  const png = Buffer.from(bytes(root.images[root.textures[0].source].bufferView)), {width, height} = asset.fields[0].planes.base_colour.image;
  assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [width, height]);
  assert.equal(inflateSync(png.subarray(41, 41 + png.readUInt32BE(33))).length, height * (1 + 3 * width));
  assert.equal(root.accessors.length, new Set([...Object.values(attributes), indices]).size);
});

test('every faulty vector is refused with the finding that its case names, and every good one is expanded', async () => {
  const folder = new URL('../../conformance/container/', import.meta.url), names = readdirSync(folder);
  for (const name of names) {
    const {code} = JSON.parse(readFileSync(new URL(`${name}/expected.json`, folder), 'utf8')), {buffer, byteOffset, length} = readFileSync(new URL(`${name}/in.glb`, folder));
    const result = expand(buffer.slice(byteOffset, byteOffset + length));
    if (code) await assert.rejects(result, (error) => error instanceof TexfError && assert.equal(error.details.finding, code, name) === undefined);
    else assert.equal(opened(await result).root.extensions?.TEXF_stream, undefined);
  }
  assert.ok(names.length >= 49);
});

test('accessors of repeated attributes and targets keep their names, extras and extensions', async () => {
  const labels = (name) => ({name, extras: {of: name}, extensions: {EXT_other: {}}}), {root} = opened(await expand(coded((tree) => {
    Object.assign(tree.accessors[2], labels('joints'));
    tree.accessors.push({componentType: 5126, count: count + 1, type: 'VEC3', ...labels('target')});
    tree.meshes[0].primitives[0].targets = [{POSITION: 6}];
  }))), [{attributes, targets}] = root.meshes[0].primitives;
  for (const [number, name] of [[attributes.JOINTS_0, 'joints'], [targets[0].POSITION, 'target']]) {
    const {extras, extensions} = root.accessors[number];
    assert.deepEqual({name: root.accessors[number].name, extras, extensions}, labels(name));
  }
});

test('a file without coded primitives is returned as it is', async () => {
  const file = coded((root) => delete root.extensions);
  assert.equal(await expand(file), file);
});

test('the plug-in binds a skinned mesh, whose material is the file\'s with a texture of the stream', unless, async () => {
  const {scene} = await new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser)).parseAsync(coded(), '');
  const [mesh] = scene.children;
  assert.ok(mesh.isSkinnedMesh && mesh.name === 'body' && mesh.skeleton.bones.length === 2);
  assert.equal(mesh.geometry.index.count, unit.indices.length);
  assert.deepEqual([mesh.material.name, mesh.material.roughness, mesh.material.map.image.width], ['skin', 0.25, asset.fields[0].planes.base_colour.image.width]);
});

/** Makes the primitive one without stored attributes. */
function bare(root) {
  root.meshes[0].primitives[0].attributes = {POSITION: 0};
  delete root.meshes[0].primitives[0].extensions.TEXF_stream.splits;
}

test('a field over voxels is shown by its shader, also of a clone, at places of the stream', unless, async () => {
  const [voxels] = (await decode(read('subset/k33'))).units, file = coded(bare, read('subset/k33'));
  const {scene} = await new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser)).parseAsync(file, '');
  const [{geometry, material}] = scene.children, place = geometry.getAttribute('_texf_place'), corner = geometry.index.array[0];
  assert.deepEqual([...place.array.subarray(3 * corner, 3 * corner + 3)], [...voxels.positions.subarray(3 * voxels.indices[0], 3 * voxels.indices[0] + 3)]);
  const shader = {uniforms: {}, vertexShader: '#include <common>\n#include <begin_vertex>', fragmentShader: '#include <common>'};
  material.clone().onBeforeCompile(shader);
  assert.match(shader.vertexShader, /vTexfPlace = _texf_place \* texfScale/);
  assert.ok(shader.uniforms.texfTable0.value.isTexture);
});

test('pictures of coded primitives are in blocks where a renderer has them', unless, async () => {
  const file = coded(() => {}, read('subset/texels_repeat')), renderer = {extensions: {has: () => true}};
  for (const given of [renderer, null]) {
    const {scene} = await new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser, {renderer: given})).parseAsync(file, '');
    const {map} = scene.getObjectByName('body').material;
    assert.deepEqual([map.isCompressedTexture === true, map.image.width, map.colorSpace], [given !== null, 24, 'srgb']);
  }
});

test('a field over voxels becomes an atlas, in which no two faces overlap', async () => {
  const {root, bytes, rows} = opened(await expand(coded(bare, read('subset/k33')))), [{attributes, indices}] = root.meshes[0].primitives;
  const side = Buffer.from(bytes(root.images[root.textures[0].source].bufferView)).readUInt32BE(16), uv = rows(attributes.TEXCOORD_0), owner = new Map();
  const faces = rows(indices).flat().map((v) => uv[v].map((value) => value * side));
  assert.ok(!('_TEXF_PLACE' in attributes) && root.samplers[root.textures[0].sampler].wrapS === 33071);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = faces.slice(f, f + 3), area = (p, q, r) => (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]), low = [0, 1].map((k) => Math.floor(Math.min(a[k], b[k], c[k])));
    for (let y = low[1]; y < Math.max(a[1], b[1], c[1]); y++) for (let x = low[0]; x < Math.max(a[0], b[0], c[0]); x++) {
      const place = [x + 0.5, y + 0.5], parts = [area(place, a, b), area(place, b, c), area(place, c, a)];
      if (!parts.every((part) => part > 1e-3)) continue; // v grows downwards, and the matrix mirrors
      assert.ok(!owner.has(x + y * side), `faces ${owner.get(x + y * side)} and ${f / 3}`);
      owner.set(x + y * side, f / 3);
    }
  }
  assert.ok(owner.size > 100);
});

test('an atlas fills its pictures together as alone, and its normals bend as the field says', async () => {
  const maps = await decode(read('subset/maps_voxels')), [{field, indices, normals}] = maps.units, {planes, keys} = maps.fields[field], bend = [230, 60, 150];
  planes.normal_object = {values: Uint8Array.from({length: 3 * keys.length}, (_, i) => bend[i % 3]), components: 3, offset: 0, levelShift: 0, image: null};
  const filled = (...lists) => {
    const atlas = new Atlas(maps, [0]), pictures = lists.map((channels) => atlas.picture(channels));
    atlas.finish();
    return {atlas, pictures: pictures.map(({data}) => data)};
  };
  const lists = [['normal', 'normal'], ['base_colour', 'base_colour', 'base_colour', 'alpha'], ['occlusion', 'roughness', 'metallic']], {atlas, pictures} = filled(...lists);
  assert.deepEqual(pictures.map((data) => data.some((value) => value < 255)), [true, true, true]);
  lists.forEach((channels, n) => assert.equal(Buffer.compare(filled(channels).pictures[0], pictures[n]), 0, channels.join()));
  const {uvs, tangents} = atlas.corners[0], unitOf = (v) => v.map((value) => value / Math.hypot(...v));
  for (let f = 0; f < indices.length; f += 3) {
    const mean = (of, width, size) => Array.from({length: size}, (_, k) => [0, 1, 2].reduce((sum, n) => sum + of[width * (f + n) + k] / 3, 0)), [x, y] = mean(uvs, 2, 2).map((v) => Math.floor(v * atlas.side));
    const n = unitOf(mean(normals, 3, 3)), t = unitOf(mean(tangents, 4, 3)), b = [0, 1, 2].map((k) => n[(k + 1) % 3] * t[(k + 2) % 3] - n[(k + 2) % 3] * t[(k + 1) % 3]);
    const wanted = unitOf(n.map((value, k) => value + bend[k] / 127.5 - 1)), [u, v] = pictures[0].subarray(4 * (y * atlas.side + x));
    for (const [axis, value] of [[t, u], [b, v]]) assert.ok(Math.abs(axis.reduce((sum, a, k) => sum + a * wanted[k], 0) - (value / 127.5 - 1)) < 0.12, `face ${f / 3}`);
  }
});

/** Makes the primitive one without stored weights. */
function plain(root) {
  bare(root);
  root.meshes[0].primitives[0].attributes.TEXCOORD_0 = 1;
}

/** Gives the primitive the stored weights as a fallback's positions, and an image of its own. */
function withFallback(root) {
  plain(root);
  root.accessors.push({bufferView: 2, componentType: 5126, count: 3, type: 'VEC3', min: [0, 0, 0], max: [1, 0, 0]}, {bufferView: 2, componentType: 5126, count: 3, type: 'VEC2'});
  root.images = [{bufferView: 3, mimeType: 'image/png'}];
  root.textures[0] = {source: 0, extensions: {TEXF_stream: {}}};
  root.meshes[0].primitives[0].attributes = {POSITION: 6, TEXCOORD_0: 7};
  root.meshes[0].primitives[0].extensions.TEXF_stream.fallback = true;
  delete root.meshes[0].primitives[0].indices;
}

test('the stream of a primitive wins over its fallback, of which nothing is left', unless, async () => {
  const [of, without] = await Promise.all([withFallback, plain].map(async (change) => opened(await expand(coded(change)))));
  const held = ({root, rows}) => [root.images.length, root.textures, root.materials, root.extensionsUsed, ...root.meshes[0].primitives.flatMap(({attributes, indices}) => [...Object.values(attributes), indices].map(rows))];
  assert.deepEqual(held(of), held(without));
  const {scene} = await new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser)).parseAsync(coded(withFallback), '');
  const [{geometry, material}] = scene.children;
  assert.deepEqual([geometry.index.count, material.map.image.width], [unit.indices.length, asset.fields[0].planes.base_colour.image.width]);
});

test('where the stream is refused, the plug-in shows the fallback and its image, and expand() is refused', unless, async () => {
  const warn = console.warn, warnings = [], file = coded(withFallback, stream.subarray(0, 200)), {Texture} = await import('three');
  console.warn = (text) => warnings.push(text);
  const images = () => ({name: 'images', loadTexture: (number) => Promise.resolve(Object.assign(new Texture(), {name: `texture ${number}`}))});
  const {scene} = await new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser)).register(images).parseAsync(file, '').finally(() => { console.warn = warn; });
  const [{geometry, material}] = scene.children;
  assert.deepEqual([geometry.attributes.position.count, material.map.name], [3, 'texture 0']);
  assert.match(warnings[0], /invalid.*the fallback is shown/);
  await assert.rejects(expand(file), {name: 'TexfError', code: 'invalid'});
});

const said = (root) => root.meshes[0].primitives[0].extensions.TEXF_stream;
for (const [what, code, change, bytes] of [
  ['a stream that is not there', 'invalid', (root) => { said(root).stream = 1; }],
  ['a unit that is not there', 'invalid', (root) => { said(root).units = [asset.units.length]; }],
  ['no units', 'invalid', (root) => { said(root).units = []; }],
  ['two primitives on one unit', 'invalid', (root) => root.meshes[0].primitives.push(root.meshes[0].primitives[0])],
  ['a matrix without inverse', 'invalid', (root) => { said(root).matrix = MATRIX.with(10, 0); }],
  ['a matrix of 15 numbers', 'invalid', (root) => { said(root).matrix = MATRIX.slice(1); }],
  ['a split of a corner that is not there', 'invalid', (root) => { root.accessors[5].byteOffset = 0; said(root).splits = 3; }],
  ['splits that are not there', 'invalid', (root) => { said(root).splits = 9; }],
  ['stored values of another count', 'invalid', (root) => { delete said(root).splits; }],
  ['stored attributes of two counts', 'invalid', (root) => { root.accessors[2].count--; }],
  ['an accessor that exceeds its view', 'invalid', (root) => { root.accessors[3].byteOffset = 16; }],
  ['an attribute that is not there', 'invalid', (root) => { root.meshes[0].primitives[0].attributes.JOINTS_0 = 77; }],
  ['a fallback of a primitive with splits', 'invalid', (root) => { said(root).fallback = true; }],
  ['a fallback that is neither true nor false', 'invalid', (root) => { said(root).fallback = 1; }],
  ['a view that inflates to another length', 'invalid', (root) => { root.bufferViews[1].byteLength += 4; }],
  ['a view that inflates to less', 'invalid', (root) => { root.bufferViews[2].byteLength -= 16; }],
  ['a view whose rows do not divide it', 'invalid', (root) => { root.bufferViews[1].extensions.TEXF_stream.row = 3; }],
  ['deflated bytes beyond the buffer', 'invalid', (root) => { root.bufferViews[1].extensions.TEXF_stream.byteOffset = 1e9; }],
  ['bytes that are not deflated', 'invalid', (root) => { root.bufferViews[1].extensions.TEXF_stream.byteOffset = 0; }],
  ['streams that are no array', 'invalid', (root) => { root.extensions.TEXF_stream.streams = 0; }],
  ['a material that is not there', 'invalid', (root) => { root.meshes[0].primitives[0].material = 3; }],
  ['a texture that is not there', 'invalid', (root) => { root.textures = []; }],
  ['primitives that are no array', 'invalid', (root) => { root.meshes[0].primitives = 3; }],
  ['a broken stream', 'invalid', () => {}, stream.subarray(0, 200)],
]) {
  test(`${what}: refused with a TexfError`, async () => {
    const file = coded(change, bytes);
    await assert.rejects(expand(file), (error) => error instanceof TexfError && error.code === code && error.message.length > 10);
    if (!three) return;
    const loader = new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser));
    await assert.rejects(loader.parseAsync(file, ''), (error) => error instanceof TexfError && error.code === code);
  });
}

const primitiveOf = (root) => root.meshes[0].primitives[0];
for (const [what, finding, change] of [
  ['a stream within another', 'TXF-I09', (root) => {
    root.bufferViews.push({buffer: 0, byteOffset: 4, byteLength: 60});
    root.extensions.TEXF_stream.streams.push(4);
  }],
  ['an extension that is no object', 'TXF-I09', (root) => { primitiveOf(root).extensions.TEXF_stream = 'VEC2'; }],
  ['streams that are null', 'TXF-I09', (root) => { root.extensions.TEXF_stream.streams = null; }],
  ['a mesh that is no object', 'TXF-I09', (root) => { root.meshes.push('c'); }],
  ['an accessor that is a number', 'TXF-I09', (root) => { root.accessors[0] = 0.8; }],
  ['a bufferView that is null', 'TXF-I09', (root) => { root.bufferViews.push(null); }],
  ['materials that are no array', 'TXF-I09', (root) => { root.materials = 2 ** 32; }],
  ['skins that are no array', 'TXF-I09', (root) => { root.skins = {}; }],
  ['names of extensions that are no array', 'TXF-I09', (root) => { root.extensionsUsed = {}; }],
  ['targets that are a text', 'TXF-I09', (root) => { primitiveOf(root).targets = 'VEC2'; }],
  ['targets that are a number', 'TXF-I09', (root) => { primitiveOf(root).targets = 1; }],
  ['an image whose bufferView is not there', 'TXF-I09', (root) => { root.images = [{bufferView: 99}]; }],
  ['a type that every object has', 'TXF-I09', (root) => { root.accessors[2].type = 'constructor'; }],
  ['splits that are signed', 'TXF-I09', (root) => { root.accessors[5].componentType = 5122; }],
  ['a matrix beyond binary32', 'TXF-I09', (root) => { said(root).matrix = MATRIX.with(12, 1e39); }],
  ['sparse indices that are signed', 'TXF-I09', (root) => { root.accessors[3].sparse = {count: 1, indices: {bufferView: 3, componentType: 5120}, values: {bufferView: 3}}; }],
  ['a stride that is a text', 'TXF-I11', (root) => { root.bufferViews[2].byteStride = '16'; }],
  ['a buffer that is shorter than it says', 'TXF-I10', (root) => { root.buffers[0].byteLength += 8; }],
  ['a data URI that is none', 'TXF-I10', (root) => { root.buffers[0].uri = 'data:'; }],
  ['a tree of 200 levels', 'TXF-I09', (root) => { root.extras = Array.from({length: 200}).reduce((inner) => [inner], []); }],
  ['deflated views of 2 GB', 'TXF-I41', (root) => { root.bufferViews[1].byteLength = root.bufferViews[2].byteLength = 2 ** 30; }],
]) {
  test(`${what}: expand() says ${finding}`, () => assert.rejects(expand(coded(change)), (error) => error instanceof TexfError && error.details.finding === finding));
}

test('a fuzzer finds nothing, and says its outcomes', () => {
  const run = spawnSync(process.execPath, [new URL('fuzz_container.mjs', import.meta.url).pathname, '--executions', '300'], {encoding: 'utf8'});
  const {executions, outcomes, findings} = JSON.parse(run.stdout);
  assert.deepEqual([run.status, executions, findings], [0, 300, []]);
  assert.ok(outcomes.value > 30 && outcomes['TXF-I09'] > 30 && Object.keys(outcomes).length > 5);
});

test.after(() => dispose());
