// Seconds from the bytes in memory to the first whole frame, by three.js in Chromium without a window:
// node time_to_picture.mjs JOB.json, in js/ after npm install (three_page.mjs). JOB.json: {"root": folder with js/src and the files,
// "files": names, "loads": n, "workers": n}. Prints {"browser", "three", "graphics", "files": {name: {"decode", "upload", "triangles"}}, each
// a list of milliseconds, "decoders": {"ours", "avif6", "etc1s"}: bytes under brotli of what a page fetches to show such a file}.

import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import path from 'node:path';
import { brotliCompressSync, constants } from 'node:zlib';
import { IMPORTS, withPage } from '../proof/three_page.mjs';

const PAGE = `<!doctype html><meta charset="utf-8"><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';
import { TEXFLoader, disposeGroup } from '/cache/js/src/three.js';
const renderer = new THREE.WebGLRenderer({ antialias: false }), gl = renderer.getContext(), libraries = '/three/examples/jsm/libs/';
document.body.append(renderer.domElement);
renderer.setSize(512, 512);
let texf, gltf;
window.prepare = (workers) => {
  texf = new TEXFLoader().setWorkerLimit(workers);
  gltf = new GLTFLoader().setDRACOLoader(new DRACOLoader().setDecoderPath(libraries + 'draco/gltf/').setWorkerLimit(workers))
    .setKTX2Loader(new KTX2Loader().setTranscoderPath(libraries + 'basis/').setWorkerLimit(workers).detectSupport(renderer));
  const graphics = gl.getExtension('WEBGL_debug_renderer_info');
  return [THREE.REVISION, gl.getParameter(graphics.UNMASKED_RENDERER_WEBGL)];
};
const held = {};
window.timed = async (name) => {
  const stream = name.endsWith('.texf'), bytes = (held[name] ??= await (await fetch('/cache/' + name)).arrayBuffer()).slice();
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(40, 1, 0.01, 100), sun = new THREE.DirectionalLight(0xffffff, 3);
  const begin = performance.now(), group = stream ? await texf.parseAsync(bytes) : (await gltf.parseAsync(bytes, '')).scene;
  const decoded = performance.now(), box = new THREE.Box3().setFromObject(group), size = box.getSize(new THREE.Vector3()).length();
  scene.add(group, sun, new THREE.AmbientLight(0xffffff, 1));
  sun.position.set(1, 2, 3);
  camera.far = 10 * size;
  camera.near = size / 100;
  camera.position.copy(box.getCenter(new THREE.Vector3())).add(new THREE.Vector3(0.3, 0.25, 1).multiplyScalar(size * 1.3));
  camera.lookAt(box.getCenter(new THREE.Vector3()));
  camera.updateProjectionMatrix();
  renderer.render(scene, camera);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the frame
  const shown = performance.now(), { triangles } = renderer.info.render;
  if (stream) disposeGroup(group);
  else group.traverse(({ geometry, material }) => [geometry, material, ...Object.values(material ?? {}).filter((map) => map?.isTexture)]
    .forEach((part) => (part?.image?.close?.(), part?.dispose())));
  return { decode: decoded - begin, upload: shown - decoded, triangles };
};
</script>`;

const { root, files, loads, workers, pictures } = JSON.parse(await readFile(process.argv[2], 'utf8'));
const three = path.dirname(path.dirname(createRequire(path.join(process.cwd(), 'x.js')).resolve('three'))), addons = path.join(three, 'examples/jsm');
const packed = async (...names) => (await Promise.all(names.map((name) => readFile(name))))
  .reduce((sum, bytes) => sum + brotliCompressSync(bytes, { params: { [constants.BROTLI_PARAM_LGWIN]: 24 } }).length, 0);

// Files that a module of js/src imports, itself among them.
async function modules(name, known = new Set()) {
  if (known.has(name)) return known;
  known.add(name);
  for (const [, next] of (await readFile(name, 'utf8')).matchAll(/from '(\.\/[^']+)'/g)) await modules(path.join(path.dirname(name), next), known);
  return known;
}

async function decoders() {
  const source = path.join(root, 'js/src'), own = await modules(path.join(source, 'worker.js'), await modules(path.join(source, 'three.js')));
  const common = ['loaders/GLTFLoader.js', 'loaders/DRACOLoader.js', 'libs/draco/gltf/draco_wasm_wrapper.js', 'libs/draco/gltf/draco_decoder.wasm'];
  const basis = ['loaders/KTX2Loader.js', 'libs/basis/basis_transcoder.js', 'libs/basis/basis_transcoder.wasm'];
  const [avif6, more] = [await packed(...common.map((name) => path.join(addons, name))), await packed(...basis.map((name) => path.join(addons, name)))];
  return { ours: await packed(path.join(source, 'texf_simd.wasm'), ...own), avif6, etc1s: avif6 + more };
}

await withPage(PAGE, root, async (browser, address) => {
  const page = await browser.newPage({ viewport: { width: 520, height: 520 } }), faults = [], result = { browser: browser.version(), files: {} };
  page.on('pageerror', (error) => faults.push(String(error)));
  page.on('console', (message) => message.type() === 'error' && faults.push(message.text()));
  await page.goto(address, { waitUntil: 'load' });
  await page.waitForFunction(() => window.timed);
  [result.three, result.graphics] = await page.evaluate((n) => window.prepare(n), workers);
  for (let load = -1; load < loads; load++) { // the first one starts workers and compiles decoders
    for (const name of files) {
      const times = await page.evaluate((file) => window.timed(file), name), row = (result.files[name] ??= { decode: [], upload: [] });
      row.triangles = times.triangles;
      if (load >= 0) ['decode', 'upload'].forEach((part) => row[part].push(times[part]));
      else if (pictures) await page.locator('canvas').screenshot({ path: path.join(pictures, `${name}.png`) });
    }
  }
  if (faults.length) throw new Error(faults.join('\n'));
  console.log(JSON.stringify({ ...result, decoders: await decoders() }));
});
