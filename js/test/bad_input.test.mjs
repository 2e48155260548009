/** What a page may get in place of a stream, and what it may do meanwhile: one sentence with the right code, and nothing is left. */

import assert from 'node:assert/strict';
import {readFileSync, readdirSync} from 'node:fs';
import {after, test} from 'node:test';
import {setTimeout} from 'node:timers/promises';

import {Decoder, TexfError} from '../src/index.js';

const vector = (name) => readFileSync(new URL(`../../conformance/${name}/in.texf`, import.meta.url));
const decoder = new Decoder({workers: 2}), texels = vector('subset/texels'), text = new TextEncoder();
const refused = (code) => (error) => error instanceof TexfError && error.code === code && /^\S.{9,}[^.\n]$/.test(error.message);
const left = (which) => which.busy.size + which.waiting.length;

test('a download that was cut is invalid wherever it was cut', async () => {
  for (const name of ['subset/texels', 'subset/k33', 'uncommon/normals_coded']) {
    const bytes = vector(name);
    for (let cut = 0; cut < 40; cut++) await assert.rejects(decoder.decode(bytes.subarray(0, Math.floor(bytes.length * cut / 40))), refused('invalid'));
    await assert.rejects(decoder.decode(bytes.subarray(0, bytes.length - 1)), refused('invalid'));
  }
});

test('every faulty vector is refused with the finding that its case names', async () => {
  const families = {S: 'invalid', U: 'unsupported', L: 'limit'}, names = readdirSync(new URL('../../conformance/faulty', import.meta.url));
  for (const name of names) {
    const {code} = JSON.parse(readFileSync(new URL(`../../conformance/faulty/${name}/case.json`, import.meta.url), 'utf8'));
    await assert.rejects(decoder.decode(vector(`faulty/${name}`)), (error) => {
      assert.deepEqual([error.details.finding, error.code], [code, families[code[4]]], name);
      return true;
    });
  }
  assert.ok(names.length > 300);
  await assert.rejects(decoder.decode(texels, {limits: {faces: 1}}), (error) => error.details.value > 1 && error.details.allowed === 1);
});

test('a page or another file in place of the stream is invalid', async () => {
  for (const words of ['<!doctype html><html><title>404</title></html>', '{"error": "not found"}', 'glTF\x02\0\0\0', '\x89PNG\r\n\x1a\n', 'version https://git-lfs'])
    await assert.rejects(decoder.decode(text.encode(words)), refused('invalid'));
  await assert.rejects(decoder.decode(new ArrayBuffer(0)), refused('invalid'));
  await assert.rejects(decoder.decode(Buffer.concat([texels, Buffer.from('\n')])), refused('invalid'));
});

test('a header that claims 4 GB, or more than there is, is refused at once', async () => {
  const begin = performance.now();
  for (const length of [[0xff, 0xff, 0xff, 0xff, 0x0f], [0x80, 0x80, 0x80, 0x80, 0x10], [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]])
    await assert.rejects(decoder.decode(Buffer.concat([texels.subarray(0, 9), Buffer.from(length), texels.subarray(10)])), refused('invalid'));
  await assert.rejects(decoder.decode(vector('faulty/length_too_large')), refused('invalid'));
  for (const name of ['num_keys_huge', 'texels_num_keys_huge', 'texels_image_huge', 'neural_latents_huge', 'unit_vertices_huge'])
    await assert.rejects(decoder.decode(vector(`faulty/${name}`)), (error) => refused('limit')(error) || refused('invalid')(error));
  assert.ok(performance.now() - begin < 5000);
});

test('every limit is kept, and options that are none are said', async () => {
  for (const name of ['fileBytes', 'vertices', 'faces', 'voxels', 'texels'])
    await assert.rejects(decoder.decode(texels, {limits: {[name]: 1}}), refused('limit'));
  assert.equal((await decoder.decode(texels, {limits: {fileBytes: 0, faces: 0}})).units.length, 1);
  for (const limits of [{faces: -1}, {faces: NaN}, {faces: 1.5}, {faces: '1'}]) await assert.rejects(decoder.decode(texels, {limits}), RangeError);
  for (const level of [-1, NaN, 0.5, '1']) await assert.rejects(decoder.decode(texels, {level}), RangeError);
});

test('streams come in any view of bytes', async () => {
  const whole = new Uint8Array([0, ...texels, 0]);
  for (const bytes of [new DataView(whole.buffer, 1, texels.length), whole.slice(1, -1).buffer]) assert.equal((await decoder.decode(bytes)).units.length, 1);
});

test('two loads at once both come, a bad one beside a good one', async () => {
  const [first, second, bad] = await Promise.allSettled([decoder.decode(texels), decoder.decode(texels), decoder.decode(texels.subarray(0, 200))]);
  assert.deepEqual(first.value.fields, second.value.fields);
  assert.ok(refused('invalid')(bad.reason));
  assert.equal(left(decoder), 0);
});

test('an aborted load that waits for its turn does not take that of another', async () => {
  const one = new Decoder({workers: 1}), control = new AbortController();
  const first = one.decode(texels), second = one.decode(texels, {signal: control.signal}), third = one.decode(texels);
  while (one.waiting.length < 2) await setTimeout(1);
  control.abort();
  await assert.rejects(second, refused('aborted'));
  await first;
  assert.equal((await Promise.race([third, setTimeout(5000, null, {ref: false})]))?.units.length, 1);
  assert.equal(left(one), 0);
  one.dispose();
});

test('an abort is heard while the module is on its way', async () => {
  const slow = new Decoder(), control = new AbortController();
  slow.module = new Promise(() => {});
  const job = slow.decode(texels, {signal: control.signal}), other = slow.decode(texels);
  control.abort();
  await assert.rejects(job, refused('aborted'));
  slow.dispose();
  await assert.rejects(other, refused('aborted'));
});

test('disposal rejects what runs, what waits and what starts, and leaves no worker', async () => {
  for (const pause of [0, 1, 5, 20]) {
    const pool = new Decoder({workers: 2}), jobs = Array.from({length: 6}, () => pool.decode(texels, {onLevel: () => {}}));
    const all = Promise.allSettled(jobs);
    await setTimeout(pause);
    pool.dispose();
    for (const job of await all) assert.ok(job.status === 'fulfilled' || refused('aborted')(job.reason));
    await setTimeout(50);
    assert.equal(left(pool) + pool.idle.length, 0);
  }
  const threads = process.getActiveResourcesInfo().filter((name) => name === 'MessagePort').length;
  assert.ok(threads <= 2, `${threads} ports`); // those of the decoder that all tests share
});

test('a module that is no module is said, and more workers wake those who wait', async () => {
  const broken = new Decoder({wasm: text.encode('<!doctype html>')});
  await assert.rejects(broken.decode(texels), refused('internal'));
  await assert.rejects(new Decoder({wasm: new URL('file:///nowhere/texf.wasm')}).decode(texels), refused('internal'));
  const pool = new Decoder({workers: 1}), jobs = [1, 2, 3].map(() => pool.decode(texels));
  await setTimeout(1);
  pool.setWorkerLimit(3);
  assert.equal((await Promise.all(jobs)).length, 3);
  pool.dispose();
});

after(() => decoder.dispose());
