// TEXFLoader beside GLTFLoader: draws a stream and the GLB that texf-dec makes of it, in one light, and tells how far they are apart.
//
//   node tools/proof/texf_three.mjs FOLDER NAME ...     FOLDER holds NAME.texf and NAME.glb; pictures and a JSON line a name come out
//
// Call it in a folder that has three and playwright-core (npm install three playwright-core).

import { mkdtemp, cp, writeFile } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';

import { withPage } from './three_page.mjs';

const PAGE = `<!doctype html><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'self'; script-src 'self' 'wasm-unsafe-eval' 'unsafe-inline'; img-src 'self' blob: data:; connect-src 'self' blob: data:; worker-src 'self'">
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<body style="margin:0"><script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { TEXFLoader, disposeGroup } from '/cache/js/src/three.js';
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setSize(640, 640);
document.body.append(renderer.domElement);
const loader = new TEXFLoader();
function frame(object) {
  const scene = new THREE.Scene(), box = new THREE.Box3().setFromObject(object), centre = box.getCenter(new THREE.Vector3());
  const radius = box.getBoundingSphere(new THREE.Sphere()).radius;
  scene.background = new THREE.Color(0.5, 0.5, 0.5);
  scene.add(object, new THREE.HemisphereLight(0xffffff, 0x888888, 2));
  const sun = new THREE.DirectionalLight(0xffffff, 2);
  sun.position.copy(centre).add(new THREE.Vector3(1, 2, 3).multiplyScalar(radius));
  sun.target.position.copy(centre);
  scene.add(sun, sun.target);
  const camera = new THREE.PerspectiveCamera(40, 1, radius / 100, radius * 10);
  camera.position.copy(centre).add(new THREE.Vector3(0.6, 0.5, 0.9).normalize().multiplyScalar(radius * 3));
  camera.lookAt(centre);
  renderer.render(scene, camera);
  const gl = renderer.getContext(), pixels = new Uint8Array(640 * 640 * 4);
  gl.readPixels(0, 0, 640, 640, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return pixels;
}
window.drawn = async (name) => {
  const bytes = await (await fetch('/cache/' + name + '.texf')).arrayBuffer();
  await loader.parseAsync(bytes); // workers are up, the module is compiled
  let begin = performance.now(), coarse = null;
  loader.setOnLevel((group) => { coarse = performance.now() - begin; disposeGroup(group); });
  const texf = await loader.parseAsync(bytes), whole = performance.now() - begin;
  loader.setOnLevel(null);
  window.ours = frame(texf);
  return { name, bytes: bytes.byteLength, coarse_ms: coarse && Math.round(coarse), whole_ms: Math.round(whole), programs: renderer.info.programs.length };
};
window.compared = async (name) => {
  const gltf = await new GLTFLoader().loadAsync('/cache/' + name + '.glb'), theirs = frame(gltf.scene);
  let sum = 0, count = 0;
  for (let i = 0; i < theirs.length; i++) {
    if (i % 4 === 3) continue;
    sum += (theirs[i] - window.ours[i]) ** 2;
    count++;
  }
  return { psnr: Math.round(1000 * Math.log10(255 * 255 / Math.max(sum / count, 1e-6))) / 100 };
};
window.loads = async (name, times) => {
  const bytes = await (await fetch('/cache/' + name + '.texf')).arrayBuffer();
  const used = [];
  for (let i = 0; i < times; i++) {
    disposeGroup(await loader.parseAsync(bytes));
    if (i % 10 === 9) used.push(Math.round((performance.memory?.usedJSHeapSize ?? 0) / 1048576));
  }
  const workers = loader.decoder.idle.length;
  loader.dispose();
  return { workers, left: loader.decoder.idle.length + loader.decoder.busy.size, megabytes: used, textures: renderer.info.memory.textures };
};
</script>`;

const [folder, ...names] = process.argv.slice(2), repository = path.resolve(new URL('../..', import.meta.url).pathname);
const root = await mkdtemp(path.join(os.tmpdir(), 'texf-three-'));
await cp(path.join(repository, 'js', 'src'), path.join(root, 'js', 'src'), { recursive: true });
for (const name of names) for (const kind of ['texf', 'glb']) await cp(path.join(folder, `${name}.${kind}`), path.join(root, `${name}.${kind}`));
await withPage(PAGE, root, async (browser, address) => {
  const page = await browser.newPage({ viewport: { width: 640, height: 640 } });
  page.on('console', (message) => console.error(message.type(), message.text()));
  page.on('pageerror', (error) => console.error('page error', String(error)));
  await page.goto(address);
  await page.waitForFunction('window.loads', null, { timeout: 60000 });
  for (const name of names) {
    const told = await page.evaluate((n) => window.drawn(n), name);
    await writeFile(path.join(folder, `${name}_texf.png`), await page.locator('canvas').screenshot());
    Object.assign(told, await page.evaluate((n) => window.compared(n), name));
    await writeFile(path.join(folder, `${name}_glb.png`), await page.locator('canvas').screenshot());
    console.log(JSON.stringify(told));
  }
  console.log(JSON.stringify(await page.evaluate((n) => window.loads(n, 50), names[0])));
});
