/** glTF-Transform reads files with coded primitives as the files that expand() makes of them. */

import assert from 'node:assert/strict';
import {readdirSync, readFileSync} from 'node:fs';
import {test} from 'node:test';

import {expand} from '../src/gltf.js';

const core = await import('@gltf-transform/core').catch(() => null); // npm install
const unless = {skip: core ? false : '@gltf-transform/core is not installed'};
const {createDecoder, TEXFStream} = core ? await import('../src/gltf_transform.js') : {};
const HOME = new URL('../../conformance/container/', import.meta.url), decoder = core && await createDecoder();
const file = (name) => new Uint8Array(readFileSync(new URL(`${name}/in.glb`, HOME)));
const reader = (dependencies = {'texf.decoder': decoder}) => new core.NodeIO().setLogger(new core.Logger(core.Logger.Verbosity.SILENT)).registerExtensions([TEXFStream]).registerDependencies(dependencies);
const refusal = (work) => work.then(() => null, ({code, details}) => ({code, ...details}));

test('every file of the conformance set is read as the one that expand() makes, or refused for the same cause', unless, async () => {
  const names = readdirSync(HOME).sort(), refused = [];
  for (const name of names) {
    const bytes = file(name), plain = new Uint8Array(await expand(bytes.buffer.slice(0)).catch(() => new ArrayBuffer(0)));
    if (!plain.length) {
      assert.deepEqual(await refusal(reader().readBinary(bytes)), await refusal(expand(bytes.buffer)), name);
      refused.push(name);
      continue;
    }
    const document = await reader().readBinary(bytes), wanted = await reader().readBinary(plain);
    assert.deepEqual(document.getRoot().listExtensionsUsed().map((extension) => extension.extensionName), []);
    assert.ok(document.getRoot().listAccessors().every((accessor) => accessor.getArray()), name);
    assert.deepEqual(await reader().writeJSON(document), await reader().writeJSON(wanted), name);
  }
  assert.ok(refused.length > 10 && names.length > refused.length + 10, `${refused.length} of ${names.length} refused`);
});

test('external images and buffers are kept', unless, async () => {
  const {json, resources} = await reader().binaryToJSON(file('skinned')), picture = Uint8Array.of(1, 2, 3);
  json.bufferViews.push({buffer: json.buffers.length, byteLength: 3});
  json.buffers.push({uri: 'more.bin', byteLength: 3});
  json.images = [...json.images ?? [], {uri: 'a.png'}, {bufferView: json.bufferViews.length - 1, mimeType: 'image/png'}];
  const document = await reader().readJSON({json, resources: {...resources, 'a.png': picture, 'more.bin': picture}});
  assert.deepEqual(document.getRoot().listTextures().filter((texture) => texture.getImage().length === 3).map((texture) => texture.getURI()), ['a.png', '']);
});

test('without the dependency, and beyond a limit, one sentence says why', unless, async () => {
  await assert.rejects(reader({}).readBinary(file('skinned')), /createDecoder/);
  const narrow = await createDecoder({limits: {faces: 1}});
  await assert.rejects(reader({'texf.decoder': narrow}).readBinary(file('skinned')), {code: 'limit'});
  await narrow.dispose();
});
