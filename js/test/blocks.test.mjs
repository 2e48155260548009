/** Blocks of textures for a graphics card; tests/web/test_chromium.py has them decoded by the browser as well. */

import assert from 'node:assert/strict';
import {test} from 'node:test';

import {Decoder, TexfError} from '../src/index.js';

const WEIGHTS = [0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64];
const pictureOf = (width, height, texel) => ({width, height, hasAlpha: true,
  data: Uint8Array.from({length: 4 * width * height}, (_, i) => texel((i >> 2) % width, Math.floor(i / 4 / width), i & 3))});

/** Texels of a BC7 block of mode 6, RGBA each. */
function decoded(block) {
  let bits = block.reduceRight((sum, byte) => sum << 8n | BigInt(byte), 0n);
  const take = (count) => {
    const value = Number(bits & (1n << BigInt(count)) - 1n);
    bits >>= BigInt(count);
    return value;
  };
  assert.equal(take(7), 64, 'mode 6');
  const ends = Array.from({length: 8}, () => 2 * take(7)), lowest = [take(1), take(1)];
  return Array.from({length: 16}, (_, n) => {
    const weight = WEIGHTS[take(n === 0 ? 3 : 4)];
    return [0, 1, 2, 3].map((k) => (64 - weight) * (ends[2 * k] + lowest[0]) + weight * (ends[2 * k + 1] + lowest[1]) + 32 >> 6);
  });
}

/** Greatest difference of a level's texels from texel(x, y, k). */
function furthest({data, width, height}, texel) {
  let most = 0;
  for (let n = 0; n < data.length / 16; n++)
    decoded(data.subarray(16 * n, 16 * n + 16)).forEach((rgba, i) => {
      const across = Math.ceil(width / 4), x = 4 * (n % across) + (i & 3), y = 4 * Math.floor(n / across) + (i >> 2);
      if (x < width && y < height) rgba.forEach((value, k) => { most = Math.max(most, Math.abs(value - texel(x, y, k))); });
    });
  return most;
}

test('blocks hold uniform and two-coloured blocks within a level and ramps within four, at borders too', async () => {
  const decoder = new Decoder({workers: 2}), cases = [
    [1, (x, y, k) => (29 * (x >> 2) + 50 * (y >> 2) + 67 * k) % 256],
    [1, (x, y, k) => (x + y & 1 ? [10, 200, 30, 255] : [250, 20, 90, 0])[k]],
    [4, (x, y, k) => [2 * x, 255 - 2 * y, x + y, 255 - x][k]]];
  for (const [most, texel] of cases)
    for (const [width, height] of [[64, 48], [61, 5]]) {
      const {format, levels} = await decoder.blocks(pictureOf(width, height, texel), 'bc7', false);
      assert.equal(format, 'bc7');
      assert.ok(furthest(levels[0], texel) <= most, `${texel}`);
    }
  decoder.dispose();
});

test('mipmaps go down to one texel, and mix colours in linear light and alpha as it is', async () => {
  const decoder = new Decoder({workers: 1}), chequer = (x, y) => (x + y) % 2 * 255;
  for (const [isColour, grey] of [[true, 188], [false, 128]]) {
    const {levels} = await decoder.blocks(pictureOf(16, 4, chequer), 'bc7', isColour);
    assert.deepEqual(levels.map(({width, height, data}) => [width, height, data.length]), [[16, 4, 64], [8, 2, 32], [4, 1, 16], [2, 1, 16], [1, 1, 16]]);
    for (const level of levels.slice(1)) assert.ok(furthest(level, (x, y, k) => (k < 3 ? grey : 128)) <= 1);
  }
  decoder.dispose();
});

test('a uniform block of ASTC is exact, and a module that is none is refused', async () => {
  const decoder = new Decoder({workers: 1}), {levels} = await decoder.blocks(pictureOf(4, 4, (x, y, k) => 50 * k + 1), 'astc', true);
  assert.deepEqual([...levels[0].data], [0xfc, 0xfd, 255, 255, 255, 255, 255, 255, 1, 1, 51, 51, 101, 101, 151, 151]);
  decoder.dispose();
  const without = new Decoder({blocksWasm: new Uint8Array(8)});
  await assert.rejects(without.blocks(pictureOf(4, 4, () => 0), 'bc7', false), (error) => error instanceof TexfError && error.code === 'internal');
  without.dispose();
});
