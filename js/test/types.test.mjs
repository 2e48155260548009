/** The packed package, as a TypeScript program meets it; left out where npm, tar or the packages for development are missing. */

import assert from 'node:assert/strict';
import {execFileSync, spawnSync} from 'node:child_process';
import {existsSync, mkdirSync, mkdtempSync, rmSync, symlinkSync, writeFileSync} from 'node:fs';
import {tmpdir} from 'node:os';
import path from 'node:path';
import {after, test} from 'node:test';
import {fileURLToPath} from 'node:url';

const home = fileURLToPath(new URL('..', import.meta.url)), modules = path.join(home, 'node_modules');
const there = ['npm', 'tar'].every((tool) => spawnSync(tool, ['--version']).status === 0)
  && ['typescript', 'three', '@types/three'].every((name) => existsSync(path.join(modules, name)));
const folder = mkdtempSync(path.join(tmpdir(), 'texf-types-'));

const CONSUMER = `
import {Decoder, TexfError, decode, dispose, type Asset, type DecodeOptions, type Limits} from 'texf';
import {CHANNELS, decodeWith, type Field, type Material, type Plane, type Unit} from 'texf/engine';
import {TEXFLoader, disposeGroup, groupOf} from 'texf/three';
import {TEXFStreamExtension, expand} from 'texf/gltf';
import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
import {WebGLRenderer, type Group} from 'three';

const limits: Limits = {faces: 1000};
const options: DecodeOptions = {level: 1, limits, onLevel: (coarse, level) => console.log(coarse.units.length, level)};
export async function shown(bytes: ArrayBuffer): Promise<Group> {
  const asset: Asset = await decode(bytes, options), decoder = new Decoder({workers: 2, wasm: null});
  const unit: Unit = asset.units[0], field: Field = asset.fields[0], material: Material = asset.materials[0];
  const plane: Plane | undefined = field.planes['base_colour'], uvs: Float32Array | null = unit.uvs;
  const loader = new TEXFLoader().setLevel(1).setLimits(limits).setWorkerLimit(2).setOnLevel((group) => disposeGroup(group))
    .detectSupport(new WebGLRenderer());
  console.log(plane?.values.length, uvs?.length, material.alphaMode === 'BLEND', CHANNELS.length, decodeWith.length);
  decoder.dispose();
  dispose();
  const group: Group = await loader.loadAsync('scan.texf');
  group.add(groupOf(asset));
  return group;
}
export async function plain(file: ArrayBuffer, decoder: Decoder): Promise<ArrayBuffer> {
  new GLTFLoader().register((parser) => new TEXFStreamExtension(parser, {decoder, limits}));
  return await expand(file, {decoder, limits});
}
export const code = (error: unknown) => error instanceof TexfError ? error.code : 'internal';
// @ts-expect-error: a level is a number
decode(new Uint8Array(1), {level: 'one'});
// @ts-expect-error: there is no such limit
const wrong: Limits = {triangles: 3};
console.log(wrong);
`;

test('a strict TypeScript program compiles against the packed package', {skip: !there && 'npm, tar or node_modules is missing'}, () => {
  const [{filename, files}] = JSON.parse(execFileSync('npm', ['pack', '--json', '--silent', '--pack-destination', folder], {cwd: home, encoding: 'utf-8'}));
  const names = files.map((file) => file.path);
  for (const name of ['src/index.js', 'src/texf.wasm', 'src/texf_simd.wasm', 'types/index.d.ts', 'types/three.d.ts', 'types/engine.d.ts']) assert.ok(names.includes(name), name);
  assert.ok(!names.some((name) => /^(test|node_modules|example)/.test(name)), names.join());
  const consumer = path.join(folder, 'consumer');
  mkdirSync(path.join(consumer, 'node_modules', 'texf'), {recursive: true});
  execFileSync('tar', ['-xzf', path.join(folder, filename), '-C', path.join(consumer, 'node_modules', 'texf'), '--strip-components=1']);
  for (const name of ['three', '@types']) symlinkSync(path.join(modules, name), path.join(consumer, 'node_modules', name));
  writeFileSync(path.join(consumer, 'package.json'), '{"type": "module"}');
  writeFileSync(path.join(consumer, 'consumer.ts'), CONSUMER);
  for (const resolution of [['bundler', 'ES2022'], ['nodenext', 'nodenext']]) {
    const run = spawnSync(process.execPath, [path.join(modules, 'typescript', 'bin', 'tsc'), '--strict', '--noEmit', '--noUnusedLocals', '--target', 'ES2022',
      '--preserveSymlinks', '--skipLibCheck', '--moduleResolution', resolution[0], '--module', resolution[1], 'consumer.ts'], {cwd: consumer, encoding: 'utf-8'});
    assert.equal(run.status, 0, run.stdout);
  }
});

after(() => rmSync(folder, {recursive: true}));
