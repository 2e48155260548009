// Source and coded GLB, or their tilesets, drawn by viewers that are not three.js, through the modules of js/src.
//
//   node tools/proof/doors/viewers.mjs babylon|playcanvas|model_viewer|cesium OUT_FOLDER SOURCE CODED
//
// Call it in a folder that has playwright-core, esbuild and the host: @babylonjs/core and @babylonjs/loaders, playcanvas,
// @google/model-viewer, or cesium. Writes source.png and coded.png, from one camera, and prints what the host says of each file: seconds
// to load and draw it, names, materials, animations, or why it is refused. Ends with 0 if both are equal, else 7.

import { mkdirSync, writeFileSync } from 'node:fs';
import { readFile } from 'node:fs/promises';
import http from 'node:http';
import { createRequire } from 'node:module';
import path from 'node:path';

const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.wasm': 'application/wasm', '.json': 'application/json', '.css': 'text/css' };
const FLAGS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'];
const HOSTS = {
  babylon: `export * from '@babylonjs/core'; import '@babylonjs/loaders/glTF/2.0/index.js';
    export {registerGLTFExtension} from '@babylonjs/loaders/glTF/2.0/glTFLoaderExtensionRegistry.js';`,
  playcanvas: `export * from 'playcanvas';`,
};
const BABYLON = `import * as B from '/host.js'; import {registerTEXF} from '/js/src/babylon.js';
registerTEXF(B.registerGLTFExtension);
const canvas = document.querySelector('canvas'), engine = new B.Engine(canvas, true, {preserveDrawingBuffer: true});
let view = null;
window.drawn = async (url) => {
  const scene = new B.Scene(engine);
  await B.AppendSceneAsync(url, scene);
  scene.createDefaultLight();
  scene.animationGroups.forEach((group) => { group.stop(); group.goToFrame(0.4 * group.to + 0.6 * group.from); });
  await scene.whenReadyAsync();
  const {min, max} = scene.getWorldExtends((mesh) => mesh.getTotalVertices() > 0), size = max.subtract(min).length();
  view ??= [0.9, 1.15, 1.35 * size, min.add(max).scale(0.5)];
  const camera = new B.ArcRotateCamera('camera', ...view, scene);
  [camera.minZ, camera.maxZ] = [0.01 * size, 10 * size];
  for (let i = 0; i < 4; i++) scene.render();
  const facts = {nodes: scene.getNodes().map((node) => node.name), materials: scene.materials.map((material) => material.name),
    animations: scene.animationGroups.map((group) => [group.name, group.targetedAnimations.length]), bones: scene.skeletons.map((skeleton) => skeleton.bones.length)};
  const picture = canvas.toDataURL('image/png');
  scene.dispose();
  return {facts, picture};
};`;
const PLAYCANVAS = `import * as pc from '/host.js'; import {addTEXF} from '/js/src/playcanvas.js';
const canvas = document.querySelector('canvas'), app = new pc.Application(canvas, {graphicsDeviceOptions: {preserveDrawingBuffer: true}});
app.autoRender = false;
app.start();
addTEXF(app);
const camera = new pc.Entity(), lamp = new pc.Entity();
camera.addComponent('camera', {fov: 35});
lamp.addComponent('light', {type: 'directional', intensity: 1.5});
app.scene.ambientLight = new pc.Color(0.4, 0.4, 0.4);
[camera, lamp].forEach((entity) => app.root.addChild(entity));
let box = null;
window.drawn = async (url) => {
  const asset = new pc.Asset(url, 'container', {url});
  await new Promise((resolve, reject) => { asset.once('load', resolve); asset.once('error', reject); app.assets.add(asset); app.assets.load(asset); });
  const entity = asset.resource.instantiateRenderEntity(), names = [];
  app.root.addChild(entity);
  entity.forEach((node) => names.push(node.name));
  const meshes = entity.findComponents('render').flatMap((render) => render.meshInstances);
  box ??= meshes.reduce((all, {aabb}) => (all.add(aabb), all), meshes[0].aabb.clone());
  const size = box.halfExtents.length(), {x, y, z} = box.center;
  [camera.camera.nearClip, camera.camera.farClip] = [0.01 * size, 20 * size];
  camera.setPosition(x + 2.2 * size, y + 1.4 * size, z + 2.6 * size);
  camera.lookAt(box.center);
  for (let i = 0; i < 4; i++) { app.renderNextFrame = true; await new Promise((resolve) => setTimeout(resolve, 150)); }
  const facts = {names, animations: asset.resource.animations.map((animation) => animation.resource.name), skins: meshes.filter((mesh) => mesh.skinInstance).length};
  const picture = canvas.toDataURL('image/png');
  entity.destroy();
  return {facts, picture};
};`;
const WORKER = `import {expandOnThisPage} from '/js/src/expand_on_this_page.js'; await expandOnThisPage('/texf_worker.js');`;
const MODEL_VIEWER = `${WORKER} await import('/node_modules/@google/model-viewer/dist/model-viewer.min.js');
window.drawn = async (src) => {
  document.body.replaceChildren();
  const viewer = Object.assign(document.createElement('model-viewer'), {src, cameraOrbit: '40deg 65deg 110%', style: 'width: 512px; height: 512px; --progress-bar-height: 0'});
  document.body.append(viewer);
  await new Promise((resolve, reject) => { viewer.addEventListener('load', resolve); viewer.addEventListener('error', () => reject(new Error('refused'))); });
  await new Promise((resolve) => setTimeout(resolve, 3000));
  return {facts: {materials: viewer.model.materials.map((material) => material.name), animations: viewer.availableAnimations, variants: viewer.availableVariants}, shot: 'model-viewer'};
};`;
const CESIUM = `${WORKER} window.CESIUM_BASE_URL = '/node_modules/cesium/Build/Cesium/';
await new Promise((resolve) => { document.head.append(Object.assign(document.createElement('script'), {src: CESIUM_BASE_URL + 'Cesium.js', onload: resolve})); });
document.querySelector('canvas').outerHTML = '<div id="c" style="width: 512px; height: 512px"></div>';
const {scene, camera, canvas} = new Cesium.CesiumWidget('c', {baseLayer: false, globe: false, skyBox: false, contextOptions: {webgl: {preserveDrawingBuffer: true}}});
let sphere = null;
window.drawn = async (url) => {
  scene.primitives.removeAll();
  const tileset = scene.primitives.add(await Cesium.Cesium3DTileset.fromUrl(url)), tiles = [], failed = [];
  tileset.tileLoad.addEventListener(({content}) => tiles.push(content.trianglesLength));
  tileset.tileFailed.addEventListener(({message}) => failed.push(message));
  sphere ??= tileset.boundingSphere;
  camera.flyToBoundingSphere(sphere, {duration: 0, offset: new Cesium.HeadingPitchRange(0.6, -0.4, 1.4 * sphere.radius)});
  for (let i = 0; i < 200 && !(i > 10 && tileset.tilesLoaded); i++) { scene.render(); await new Promise((resolve) => setTimeout(resolve, 60)); }
  scene.render();
  return {facts: {tiles: tiles.sort(), failed}, picture: canvas.toDataURL('image/png')};
};`;
const PAGES = { babylon: BABYLON, playcanvas: PLAYCANVAS, model_viewer: MODEL_VIEWER, cesium: CESIUM };

const [host, out, ...files] = process.argv.slice(2), here = process.cwd(), require = createRequire(path.join(here, 'x.js'));
const repository = path.resolve(import.meta.dirname, '../../..'), served = new Map([
  ['/', `<!doctype html><meta charset="utf-8"><body style="margin: 0"><canvas width="512" height="512"></canvas><script type="module">${PAGES[host]}</script>`],
  ['/texf_worker.js', `import '/js/src/service_worker.js';`]]);
if (HOSTS[host]) {
  const bundle = await require('esbuild').build({ stdin: { contents: HOSTS[host], resolveDir: here }, bundle: true, format: 'esm', write: false, logLevel: 'error' });
  served.set('/host.js', bundle.outputFiles[0].text);
}
const server = http.createServer(async (request, response) => {
  const name = path.posix.normalize(decodeURIComponent(new URL(request.url, 'http://x').pathname)), [, top, ...rest] = name.split('/');
  const roots = { js: path.join(repository, 'js'), node_modules: path.join(here, 'node_modules'), source: path.dirname(files[0]), coded: path.dirname(files[1]) };
  const body = served.get(name) ?? await readFile(path.join(roots[top] ?? '/nowhere', ...rest)).catch(() => null);
  response.writeHead(body === null ? 404 : 200, { 'content-type': name === '/' ? 'text/html' : TYPES[path.extname(name)] ?? 'application/octet-stream' }).end(body ?? '');
});
await new Promise((ready) => server.listen(0, '127.0.0.1', ready));
const browser = await require('playwright-core').chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: FLAGS });
const page = await browser.newPage({ viewport: { width: 512, height: 512 } }), facts = [];
await page.goto(`http://127.0.0.1:${server.address().port}/`);
await page.waitForFunction(() => window.drawn, null, { timeout: 120000 });
mkdirSync(out, { recursive: true });
for (const [n, kind] of ['source', 'coded'].entries()) {
  const begin = performance.now(), answer = await page.evaluate((url) => window.drawn(url).catch((error) => ({ facts: { error: error.message } })), `/${kind}/${path.basename(files[n])}`);
  const picture = answer.shot ? await page.locator(answer.shot).screenshot() : Buffer.from((answer.picture ?? '').split(',').at(-1), 'base64');
  writeFileSync(path.join(out, `${kind}.png`), picture);
  facts.push(JSON.stringify(answer.facts));
  console.log(kind, `${((performance.now() - begin) / 1000).toFixed(1)} s`, facts[n]);
}
await browser.close();
server.close();
process.exitCode = facts[0] === facts[1] ? 0 : 7;
