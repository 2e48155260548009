// Pictures of GLB files side by side in a browser, by three.js, mip levels in play: one column per file, one row per distance.
// node bench/browser_view.mjs OUT.png FILE.glb... [--distances 2.2,9] [--from 0.4,0.2,1] [--trilinear] [--lit | --pbr] [--difference]
// distances: in radii of the first file's box; from: direction of the eye; trilinear: every texture linear with linear mip
// levels, whatever its sampler says; lit: shaded by normals, with base colours only, in place of the colours themselves; pbr: the
// materials as they are, in three.js's room; difference: a further column, four times what the last file differs from the first.
// Needs the packages three and playwright-core where node finds them from the current directory (npm install three
// playwright-core) and a Chromium, at $CHROMIUM or /usr/bin/chromium. Serves the files to that browser from 127.0.0.1 only.

import { readFile } from 'node:fs/promises';
import http from 'node:http';
import { createRequire } from 'node:module';
import path from 'node:path';

const SIDE = 480;
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.glb': 'model/gltf-binary' };
const require = createRequire(path.join(process.cwd(), 'x.js'));

const PAGE = `<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script><script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { RoomEnvironment } from 'three/addons/environments/RoomEnvironment.js';
const { files, distances, from, trilinear, lit, pbr, difference } = JSON.parse(decodeURIComponent(location.hash.slice(1)));
function show(mesh) {
  const from = mesh.material, map = from.map;
  if (map && trilinear) Object.assign(map, { minFilter: THREE.LinearMipmapLinearFilter, magFilter: THREE.LinearFilter });
  const { color, side, alphaTest, transparent, vertexColors } = from;
  mesh.material = new (lit ? THREE.MeshLambertMaterial : THREE.MeshBasicMaterial)(
    { map, color, side, alphaTest, transparent, vertexColors });
}
async function load(file, number) {
  const scene = new THREE.Scene(), model = (await new GLTFLoader().loadAsync('/file/' + number + '.glb')).scene;
  if (!pbr) model.traverse((one) => one.isMesh && show(one));
  const sun = new THREE.DirectionalLight(0xffffff, 2);
  sun.position.set(1, 2, 3);
  scene.add(model);
  if (!pbr) scene.add(new THREE.HemisphereLight(0xffffff, 0x404040, 2), sun);
  scene.background = new THREE.Color(0x777777);
  return scene;
}
async function draw() {
  const scenes = await Promise.all(files.map(load)), box = new THREE.Box3().setFromObject(scenes[0].children[0]);
  const centre = box.getCenter(new THREE.Vector3()), radius = box.getSize(new THREE.Vector3()).length() / 2;
  const camera = new THREE.PerspectiveCamera(40, 1, radius / 100, radius * 100), eye = new THREE.Vector3(...from).normalize();
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  if (pbr) {
    const room = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment(), 0.04).texture;
    for (const scene of scenes) scene.environment = room;
  }
  renderer.setSize(${SIDE} * (files.length + (difference ? 1 : 0)), ${SIDE} * distances.length);
  renderer.setScissorTest(true);
  document.body.append(renderer.domElement);
  distances.forEach((distance, row) => scenes.forEach((scene, column) => {
    const place = [${SIDE} * column, ${SIDE} * (distances.length - 1 - row), ${SIDE}, ${SIDE}];
    camera.position.copy(centre).addScaledVector(eye, radius * distance);
    camera.lookAt(centre);
    renderer.setViewport(...place);
    renderer.setScissor(...place);
    renderer.render(scene, camera);
  }));
  if (difference) subtract(renderer);
}
function subtract(renderer) {
  const gl = renderer.getContext(), side = ${SIDE}, flat = document.createElement('canvas');
  const height = side * distances.length, read = (column) => {
    const pixels = new Uint8Array(4 * side * height);
    gl.readPixels(column * side, 0, side, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  };
  const a = read(0), b = read(files.length - 1), image = new ImageData(side, height);
  for (let y = 0; y < height; y++) for (let x = 0; x < side; x++) for (let c = 0; c < 4; c++) {
    const to = 4 * (y * side + x) + c, at = 4 * ((height - 1 - y) * side + x) + c;
    image.data[to] = c === 3 ? 255 : 4 * Math.abs(a[at] - b[at]);
  }
  Object.assign(flat, { width: side, height }).getContext('2d').putImageData(image, 0, 0);
  flat.style = 'position:absolute;top:0;left:' + side * files.length + 'px';
  document.body.append(flat);
}
draw().then(() => { document.title = 'done'; }, (error) => { document.title = 'failed: ' + error; });
</script>`;

function parse(words) {
  const told = { distances: [2.2, 9], from: [0.4, 0.2, 1], trilinear: false, lit: false, pbr: false, difference: false, files: [] };
  while (words.length) {
    const word = words.shift(), name = word.replace(/^--/, '');
    if (['--trilinear', '--lit', '--pbr', '--difference'].includes(word)) told[name] = true;
    else if (word === '--distances' || word === '--from') told[name] = words.shift().split(',').map(Number);
    else told.files.push(word);
  }
  return told;
}

const told = parse(process.argv.slice(2));
const out = told.files.shift();
if (told.files.length === 0) {
  console.error('usage: node bench/browser_view.mjs OUT.png FILE.glb... [--distances A,B] [--from X,Y,Z] [--trilinear] [--lit | --pbr] [--difference]');
  process.exit(2);
}
const three = path.dirname(path.dirname(require.resolve('three')));
const server = http.createServer(async (request, response) => {
  const name = path.posix.normalize(new URL(request.url, 'http://x').pathname), [, root, rest] = name.split('/');
  const file = root === 'file' ? told.files[parseInt(rest, 10)] : path.join(three, name.slice('/three'.length));
  const body = name === '/' ? PAGE : await readFile(file).catch(() => null);
  response.writeHead(body === null ? 404 : 200, { 'content-type': TYPES[path.extname(name)] ?? 'text/html' }).end(body ?? '');
}).listen(0, '127.0.0.1', async () => {
  const browser = await require('playwright-core').chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
  });
  const viewport = { width: SIDE * (told.files.length + (told.difference ? 1 : 0)), height: SIDE * told.distances.length };
  const page = await browser.newPage({ viewport });
  await page.goto(`http://127.0.0.1:${server.address().port}/#${encodeURIComponent(JSON.stringify(told))}`);
  await page.waitForFunction(() => document.title.length > 0, null, { timeout: 180000 });
  const title = await page.title();
  if (title === 'done') await page.screenshot({ path: out });
  else console.error(title);
  await browser.close();
  server.close();
  process.exitCode = title === 'done' ? 0 : 1;
});
