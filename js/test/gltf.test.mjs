/** TEXFStreamExtension in node: GLBs made here of a vector's stream and a triangle as the fallback. */

import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import {test} from 'node:test';

import {Decoder, dispose} from '../src/index.js';

const three = await import('three/addons/loaders/GLTFLoader.js').catch(() => null); // npm install three
const {RGBA_ASTC_4x4_Format, RGBA_BPTC_Format} = three ? await import('three') : {};
const {TEXFStreamExtension} = three ? await import('../src/gltf.js') : {};
const unless = {skip: three ? false : 'three is not installed'};
const stream = readFileSync(new URL('../../conformance/subset/texels/in.texf', import.meta.url));

/** A GLB of a triangle whose scene carries bytes. */
function carrying(bytes, extension = {bufferView: 1}) {
  const triangle = Buffer.from(new Float32Array([0, 0, 0, 1, 0, 0, 0, 1, 0]).buffer), rest = Buffer.alloc(-bytes.length & 3);
  const json = {
    asset: {version: '2.0'}, extensionsUsed: ['TEXF_stream'], scene: 0, scenes: [{nodes: [0], extensions: {TEXF_stream: extension}}],
    nodes: [{mesh: 0, name: 'fallback'}], meshes: [{primitives: [{attributes: {POSITION: 0}}]}],
    accessors: [{bufferView: 0, componentType: 5126, count: 3, type: 'VEC3', min: [0, 0, 0], max: [1, 1, 0]}],
    bufferViews: [{buffer: 0, byteLength: 36}, {buffer: 0, byteOffset: 36, byteLength: bytes.length}],
    buffers: [{byteLength: 36 + bytes.length + rest.length}],
  };
  const chunk = (kind, data) => Buffer.concat([Buffer.from(new Uint32Array([data.length, kind]).buffer), data]);
  const text = JSON.stringify(json), body = Buffer.concat([chunk(0x4E4F534A, Buffer.from(text.padEnd(text.length + 3 & ~3))),
    chunk(0x004E4942, Buffer.concat([triangle, bytes, rest]))]);
  const file = Buffer.concat([Buffer.from('glTF'), Buffer.from(new Uint32Array([2, 12 + body.length]).buffer), body]);
  return file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
}

/** The scene that a GLTFLoader with the plug-in makes of a file, and what is warned of meanwhile. */
async function parsed(file, options) {
  const loader = new three.GLTFLoader().register((parser) => new TEXFStreamExtension(parser, options));
  const said = [], warn = console.warn;
  console.warn = (...words) => said.push(words.join(' '));
  try {
    return {gltf: await loader.parseAsync(file, ''), said};
  } finally {
    console.warn = warn;
  }
}

test('the stream stands in place of the nodes', unless, async () => {
  const decoder = new Decoder({workers: 1}), asset = await decoder.decode(stream);
  const {gltf, said} = await parsed(carrying(stream), {decoder});
  const [group] = gltf.scene.children, [mesh] = group.children;
  assert.deepEqual(said, []);
  assert.equal(gltf.scene.children.length, 1);
  assert.equal(gltf.scene.getObjectByName('fallback'), undefined);
  assert.deepEqual(group.position.toArray(), asset.origin);
  assert.equal(mesh.geometry.index.count, asset.units[0].indices.length);
  assert.equal(mesh.material.map.image.width, asset.fields[0].planes.base_colour.image.width);
  const coarse = (await parsed(carrying(stream), {decoder, level: 1})).gltf.scene.children[0].children[0];
  assert.equal(coarse.material.map.image.width, Math.ceil(mesh.material.map.image.width / 2));
  decoder.dispose();
});

test('textures are in blocks where a renderer has them and their sides allow it, else in texels', unless, async () => {
  const repeated = readFileSync(new URL('../../conformance/subset/texels_repeat/in.texf', import.meta.url));
  const has = (...parts) => ({extensions: {has: (name) => parts.some((part) => name.includes(part))}});
  const mapOf = async (renderer, level) => (await parsed(carrying(repeated), {renderer, level})).gltf.scene.children[0].children[0].material.map;
  for (const [renderer, wanted] of [[has('bptc', 'astc'), RGBA_BPTC_Format], [has('astc'), RGBA_ASTC_4x4_Format]]) {
    const {isCompressedTexture, mipmaps, format, colorSpace} = await mapOf(renderer, 0);
    assert.deepEqual([isCompressedTexture, mipmaps.map(({width}) => width), format, colorSpace], [true, [24, 12, 6, 3, 1], wanted, 'srgb']);
  }
  assert.ok((await mapOf(has('s3tc'), 0)).isDataTexture);
  assert.ok((await mapOf(has('bptc'), 2)).isDataTexture); // 6 x 4 texels
});

test('a page\'s shared decoder takes the stream where no other is given', unless, async () => {
  assert.equal((await parsed(carrying(stream))).gltf.scene.children[0].type, 'Group');
});

for (const [what, file, options, code] of [
  ['a broken stream', () => carrying(stream.subarray(0, 200)), {}, 'invalid'],
  ['a stream of another version', () => carrying(readFileSync(new URL('../../conformance/faulty/version/in.texf', import.meta.url))), {}, 'unsupported'],
  ['a stream over a limit', () => carrying(stream), {limits: {faces: 1}}, 'limit'],
  ['an abort', () => carrying(stream), {signal: AbortSignal.abort()}, 'aborted'],
  ['a bufferView that is not there', () => carrying(stream, {bufferView: 9}), {}, 'invalid'],
  ['no bufferView', () => carrying(stream, {}), {}, 'invalid'],
  ['an extension that is no object', () => carrying(stream, null), {}, 'invalid'],
]) {
  test(`${what}: the fallback is shown, and one warning says why`, unless, async () => {
    const {gltf, said} = await parsed(file(), options);
    assert.equal(gltf.scene.children.length, 1);
    assert.equal(gltf.scene.children[0].name, 'fallback');
    assert.equal(said.length, 1);
    assert.match(said[0], new RegExp(`^TEXF_stream: ${code}: .*; the fallback is shown$`));
  });
}

test('without the plug-in the fallback is shown', unless, async () => {
  const gltf = await new three.GLTFLoader().parseAsync(carrying(stream), '');
  assert.equal(gltf.scene.children[0].name, 'fallback');
});

test.after(() => dispose());
