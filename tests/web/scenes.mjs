// glTF files drawn by GLTFLoader with the plug-in of js/src, at times of their first animation, from a camera that the first file fits.
// node scenes.mjs OUT_FOLDER "TIMES" FILE.glb ... in a folder where node finds three and playwright-core. Writes OUT_FOLDER/FILE-TIME.rgba,
// 8 bits of RGBA, and prints {"size", "files": {FILE: facts, or the code and message of what is refused}}.

import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import path from 'node:path';
import { IMPORTS, withPage } from '../../tools/proof/three_page.mjs';

const SIZE = 512, REPOSITORY = path.resolve(import.meta.dirname, '../..');
const PAGE = `<!doctype html><meta charset="utf-8"><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { TEXFStreamExtension } from '/cache/js/src/gltf.js';
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true }), scene = new THREE.Scene();
renderer.setSize(${SIZE}, ${SIZE});
scene.background = new THREE.Color(0.4, 0.4, 0.45);
const lamp = new THREE.DirectionalLight(0xffffff, 2.5);
lamp.position.set(1, 2, 3);
scene.add(new THREE.HemisphereLight(0xffffff, 0x666655, 1.5), lamp);
let camera = null;
function fit(object) {
  const sphere = new THREE.Box3().setFromObject(object, true).getBoundingSphere(new THREE.Sphere());
  camera = new THREE.PerspectiveCamera(35, 1, 0.01 * sphere.radius, 20 * sphere.radius);
  camera.position.set(2, 1.2, 2.6).setLength(3.6 * sphere.radius).add(sphere.center);
  camera.lookAt(sphere.center);
}
function pixels() {
  const gl = renderer.getContext(), out = new Uint8Array(4 * ${SIZE * SIZE});
  gl.readPixels(0, 0, ${SIZE}, ${SIZE}, gl.RGBA, gl.UNSIGNED_BYTE, out);
  let text = '';
  for (let i = 0; i < out.length; i += 32768) text += String.fromCharCode(...out.subarray(i, i + 32768));
  return btoa(text);
}
window.drawn = async (name, times) => {
  try {
    const gltf = await new GLTFLoader().register((parser) => new TEXFStreamExtension(parser)).loadAsync('/file/' + name);
    const mixer = new THREE.AnimationMixer(gltf.scene), meshes = [];
    if (gltf.animations.length) mixer.clipAction(gltf.animations[0]).play();
    gltf.scene.traverse((object) => object.isMesh && meshes.push(object));
    scene.add(gltf.scene);
    const pictures = times.map((time) => {
      mixer.setTime(time);
      scene.updateMatrixWorld(true);
      if (!camera) fit(gltf.scene);
      renderer.render(scene, camera);
      return pixels();
    });
    gltf.scene.removeFromParent();
    const facts = { meshes: meshes.length, skinned: meshes.filter((mesh) => mesh.isSkinnedMesh).length, animations: gltf.animations.length,
      targets: meshes.map((mesh) => Object.keys(mesh.morphTargetDictionary ?? {})).flat(), types: [...new Set(meshes.map((mesh) => mesh.material.type))] };
    return { facts, pictures };
  } catch (error) {
    return { facts: { code: error.code ?? error.name, message: error.message }, pictures: [] };
  }
};
</script>`;

const [out, timeText, ...files] = process.argv.slice(2), times = timeText.split(' ').map(Number), named = {}, said = [];
const name = (n) => `${n}-${path.basename(files[n])}`, serve = (n) => (_, response) => response.end(readFileSync(files[n]));
mkdirSync(out, { recursive: true });
const routes = Object.fromEntries(files.map((_, n) => [`/file/${name(n)}`, serve(n)]));
await withPage(PAGE, REPOSITORY, async (browser, address) => {
  const page = await browser.newPage({ viewport: { width: SIZE, height: SIZE } });
  page.on('console', (message) => !/GPU stall/.test(message.text()) && said.push(message.text()));
  page.on('pageerror', (error) => said.push(String(error)));
  await page.goto(address, { waitUntil: 'load' });
  await page.waitForFunction(() => window.drawn);
  for (const n of files.keys()) {
    const { facts, pictures } = await page.evaluate(([file, when]) => window.drawn(file, when), [name(n), times]);
    pictures.forEach((picture, t) => writeFileSync(path.join(out, `${n}-${t}.rgba`), Buffer.from(picture, 'base64')));
    named[n] = facts;
  }
}, { routes });
console.log(JSON.stringify({ size: SIZE, files: named, said }));
