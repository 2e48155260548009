/** The package in node: what decode() gives, and that nothing is left behind. */

import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import {test} from 'node:test';
import {setTimeout} from 'node:timers/promises';

import {Decoder, TexfError, decode, dispose} from '../src/index.js';
import {partsOf} from '../src/parts.js';

const vector = (name) => readFileSync(new URL(`../../conformance/${name}/in.texf`, import.meta.url));
const refused = (code) => (error) => error instanceof TexfError && error.code === code && error.message.length > 5;

test('a stream over texels has images, UVs and normals', async () => {
  const asset = await decode(vector('subset/texels'));
  const {image, components} = asset.fields[0].planes.base_colour;
  assert.equal(image.data.length, image.width * image.height * components);
  assert.equal(asset.units[0].uvs.length / 2, asset.units[0].positions.length / 3);
  assert.equal(asset.units[0].normals.length, 3 * asset.units[0].indices.length);
  for (let i = 0; i < asset.units[0].normals.length; i += 3)
    assert.ok(Math.abs(Math.hypot(...asset.units[0].normals.subarray(i, i + 3)) - 1) < 1e-5);
  assert.equal(asset.fields[0].keys.length * 3, asset.fields[0].planes.base_colour.values.length);
});

test('the caller\'s bytes stay', async () => {
  const bytes = vector('subset/texels'), before = bytes.slice();
  await decode(bytes);
  assert.deepEqual(bytes, before);
  const large = Buffer.from(new Uint8Array(bytes).buffer); // no part of a pool, so that it could be given away
  await decode(large);
  assert.deepEqual(large, before);
});

test('parts that are decoded side by side give what one worker gives', async () => {
  const one = new Decoder({workers: 1, splitBytes: 0}), three = new Decoder({workers: 3, splitBytes: 0});
  for (const name of ['maps_texels', 'maps_voxels', 'two_fields', 'alpha_mask', 'materials', 'neural_hash'])
    for (const level of [0, 1]) {
      const bytes = vector(`subset/${name}`);
      assert.deepEqual(await three.decode(bytes, {level}), await one.decode(bytes, {level}), name);
    }
  assert.ok(three.idle.length > 1 && one.idle.length === 1);
  await assert.rejects(three.decode(vector('subset/maps_texels').subarray(0, -20)), refused('invalid'));
  const control = new AbortController(), aborted = three.decode(vector('subset/maps_texels'), {signal: control.signal});
  control.abort();
  await assert.rejects(aborted, refused('aborted'));
  assert.equal(three.jobs, 0);
  one.dispose();
  three.dispose();
});

test('a stream is split by its attribute units where that pays', () => {
  const maps = vector('subset/maps_texels'), parts = partsOf(maps, 2, 0);
  assert.equal(parts.length, 2);
  assert.equal(parts[0] | parts[1], 7);
  assert.ok((parts[0] & parts[1]) === 0 && parts[0] % 2 === 1);
  for (const whole of [partsOf(maps, 1, 0), partsOf(maps, 2, 65536), partsOf(vector('subset/k33'), 2, 0), partsOf(new Uint8Array(3), 2, 0)])
    assert.deepEqual(whole, [-1]);
});

test('texels count beside bytes where a stream is split', () => {
  assert.equal(partsOf(vector('subset/maps_texels'), 2, 900).length, 2); // 865 bytes, and 120 texels in 3 units
});

test('the module with vectors is fetched where they run, the plain one elsewhere', async () => {
  const {compile, validate} = WebAssembly, bytes = [];
  try {
    WebAssembly.compile = (module) => (bytes.push(Buffer.from(module)), compile(module));
    await new Decoder().preload();
    WebAssembly.validate = () => false;
    await new Decoder().preload();
  } finally {
    Object.assign(WebAssembly, {compile, validate});
  }
  ['texf_simd.wasm', 'texf.wasm'].forEach((name, i) => assert.ok(bytes[i].equals(readFileSync(new URL(`../src/${name}`, import.meta.url))), name));
});

test('a coarse asset comes before the whole', async () => {
  const seen = [], decoder = new Decoder({workers: 2});
  const whole = await decoder.decode(vector('subset/k33'), {onLevel: (asset, level) => seen.push([asset.fields[0].keys.length, level]), coarse: 2});
  assert.ok(seen.length <= 1 && seen.every(([keys, level]) => level === 2 && keys < whole.fields[0].keys.length));
  decoder.dispose();
});

test('refusals are of their kind', async () => {
  await assert.rejects(decode(new Uint8Array(0)), refused('invalid'));
  await assert.rejects(decode(vector('faulty/values_crc')), refused('invalid'));
  await assert.rejects(decode(vector('faulty/version')), refused('unsupported'));
  await assert.rejects(decode(vector('faulty/num_keys_huge')), refused('limit'));
  await assert.rejects(decode(vector('subset/texels'), {limits: {faces: 3}}), refused('limit'));
  await assert.rejects(decode(vector('subset/texels'), {limits: {fileBytes: 8}}), refused('limit'));
  await assert.rejects(decode(vector('subset/texels').subarray(0, 300)), refused('invalid'));
});

test('an aborted decode is rejected, and others go on', async () => {
  const decoder = new Decoder({workers: 1}), control = new AbortController();
  const first = decoder.decode(vector('subset/texels'), {signal: control.signal}), second = decoder.decode(vector('subset/texels'));
  control.abort();
  await assert.rejects(first, refused('aborted'));
  assert.equal((await second).units.length, 1);
  await assert.rejects(decoder.decode(vector('subset/texels'), {signal: AbortSignal.abort()}), refused('aborted'));
  decoder.dispose();
});

test('disposal in the middle rejects what is not finished, and a decoder starts again', async () => {
  const decoder = new Decoder({workers: 2}), jobs = Array.from({length: 5}, () => decoder.decode(vector('subset/texels')));
  await setTimeout(20);
  const all = Promise.allSettled(jobs);
  decoder.dispose();
  for (const job of await all) assert.ok(job.status === 'fulfilled' || refused('aborted')(job.reason) || job.reason instanceof TexfError);
  assert.equal((await decoder.decode(vector('subset/texels'))).units.length, 1);
  decoder.dispose();
  assert.equal(decoder.idle.length + decoder.busy.size, 0);
});

test('fifty loads do not grow', async () => {
  const decoder = new Decoder({workers: 2});
  for (let i = 0; i < 50; i++) await decoder.decode(vector('subset/texels'));
  assert.ok(decoder.idle.length <= 2);
  decoder.dispose();
  assert.equal(decoder.idle.length + decoder.busy.size, 0);
});

test('a module that is not there is said, and the next try may have more luck', async () => {
  const decoder = new Decoder({wasm: new URL('file:///nowhere/texf.wasm')});
  await assert.rejects(decoder.decode(vector('subset/texels')));
  decoder.wasm = readFileSync(new URL('../src/texf.wasm', import.meta.url));
  assert.equal((await decoder.decode(vector('subset/texels'))).units.length, 1);
  decoder.dispose();
});

test.after(() => dispose());
