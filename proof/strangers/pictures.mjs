// Sources and decoded meshes beside each other, drawn by three.js in a browser without a window, 20 pairs a sheet.
// node pictures.mjs PAIRS.json OUT_FOLDER, in a folder where node finds three and playwright-core, with a Chromium at $CHROMIUM or
// /usr/bin/chromium. PAIRS.json: {"root", "pairs": [{"source", "mesh", "text"}]}, paths below root. Writes sheet-N.png, and pairs.json:
// a row for each pair: "psnr" of both pictures in dB in flat colours (null: the same) and "lit" in light, "cover": pixels that both
// cover of those that either does, "size": how far their boxes differ, of the source's; or "error".

import { readFile, writeFile } from 'node:fs/promises';
import path from 'node:path';
import { IMPORTS, withPage } from '../three_page.mjs';

const SIDE = 240, COLUMNS = 4, SHEET = 20, SECONDS = 60;

const PAGE = `<!doctype html><meta charset="utf-8"><style>
body { margin: 0; font: 11px sans-serif; display: grid; grid-template-columns: repeat(${COLUMNS}, ${2 * SIDE + 8}px); background: #fff; }
div { padding: 4px; overflow: hidden; } p { margin: 0; height: 42px; overflow-wrap: anywhere; } img { display: block; }
</style><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
import { OBJLoader } from 'three/addons/loaders/OBJLoader.js';
import { MTLLoader } from 'three/addons/loaders/MTLLoader.js';
import { STLLoader } from 'three/addons/loaders/STLLoader.js';
import { PLYLoader } from 'three/addons/loaders/PLYLoader.js';
import { ColladaLoader } from 'three/addons/loaders/ColladaLoader.js';
import { ThreeMFLoader } from 'three/addons/loaders/3MFLoader.js';
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true, alpha: true });
renderer.setSize(${SIDE}, ${SIDE});
const draco = new DRACOLoader().setDecoderPath('/three/examples/jsm/libs/draco/gltf/');
const gltf = async (url) => (await new GLTFLoader().setDRACOLoader(draco).setMeshoptDecoder(MeshoptDecoder).loadAsync(url)).scene;
const bare = (loader) => async (url) => {
  const geometry = await loader.loadAsync(url);
  if (!geometry.getAttribute('normal')) geometry.computeVertexNormals();
  return new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ vertexColors: geometry.hasAttribute('color') }));
};
const READERS = {
  glb: gltf, gltf, stl: bare(new STLLoader()), ply: bare(new PLYLoader()), '3mf': (url) => new ThreeMFLoader().loadAsync(url),
  async obj(url) {
    const folder = url.slice(0, url.lastIndexOf('/') + 1), text = await (await fetch(url)).text(), loader = new OBJLoader();
    const library = /^mtllib\\s+(.+?)\\s*$/m.exec(text);
    if (library) {
      const materials = await new MTLLoader().setPath(folder).loadAsync(library[1].replace(/\\\\/g, '/')).catch(() => null);
      if (materials) { materials.preload(); loader.setMaterials(materials); }
    }
    return loader.parse(text);
  },
  async dae(url) {  // as the file has it: texfcodec neither turns nor scales
    const { scene } = await new ColladaLoader().loadAsync(url);
    scene.rotation.set(0, 0, 0);
    scene.scale.setScalar(1);
    return scene;
  },
};
const idle = () => new Promise((done) => { THREE.DefaultLoadingManager.onLoad = done; setTimeout(done, 1500); });
async function load(file) {
  const waiting = idle(), suffix = file.split('.').pop().toLowerCase();
  if (!READERS[suffix]) throw new Error('three.js reads no .' + suffix);
  const late = new Promise((_, fail) => setTimeout(() => fail(new Error('took longer than ${SECONDS} s')), ${SECONDS * 1000}));
  const model = await Promise.race([READERS[suffix]('/cache/' + file.split('/').map(encodeURIComponent).join('/')), late]);
  if (suffix === 'obj' || suffix === 'dae' || suffix === '3mf') await waiting;  // their images come later
  const scene = new THREE.Scene(), sun = new THREE.DirectionalLight(0xffffff, 2);
  sun.position.set(1, 2, 3);
  return scene.add(model, sun, new THREE.HemisphereLight(0xffffff, 0x404040, 1.5)) && { scene, model };
}
function dress({ model }, Kind) {  // ColladaLoader forgets colours of vertices, and normals that are not there
  const dressed = ({ map, color, side, alphaTest, transparent, opacity, flatShading }, geometry) => {
    const light = Kind === THREE.MeshBasicMaterial ? {} : { flatShading: flatShading || !geometry.hasAttribute('normal') };
    return new Kind({ map, color, side, alphaTest, transparent, opacity, vertexColors: geometry.hasAttribute('color'), ...light });
  };
  model.traverse((mesh) => {
    if (!mesh.isMesh) return;
    mesh.own ??= mesh.material;
    mesh.material = Array.isArray(mesh.own) ? mesh.own.map((own) => dressed(own, mesh.geometry)) : dressed(mesh.own, mesh.geometry);
  });
}
function shown({ scene }, camera, background) {
  scene.background = background;
  renderer.setClearColor(0, 0);
  renderer.render(scene, camera);
}
function pixels() {
  const gl = renderer.getContext(), data = new Uint8Array(4 * ${SIDE * SIDE});
  gl.readPixels(0, 0, ${SIDE}, ${SIDE}, gl.RGBA, gl.UNSIGNED_BYTE, data);
  return data;
}
function compared(a, b) {
  let squares = 0, both = 0, either = 0;
  for (let i = 0; i < a.length; i += 4) {
    const here = a[i + 3] === 255, there = b[i + 3] === 255;
    either += here || there;
    if (!(here && there)) continue;
    both += 1;
    for (let c = 0; c < 3; c++) squares += (a[i + c] - b[i + c]) ** 2;
  }
  return [squares === 0 ? null : 10 * Math.log10(255 ** 2 * 3 * both / squares), either ? both / either : null];
}
async function draw({ source, mesh, text }) {
  const cell = document.createElement('div');
  document.body.append(cell);
  let row;
  try {
    const sides = [await load(source), await load(mesh)], boxes = sides.map(({ model }) => new THREE.Box3().setFromObject(model, true));
    if (boxes[0].isEmpty()) throw new Error('three.js shows nothing of the source');
    const [extent, other] = boxes.map((box) => box.getSize(new THREE.Vector3())), centre = boxes[0].getCenter(new THREE.Vector3());
    const radius = extent.length() / 2 || 1, camera = new THREE.PerspectiveCamera(40, 1, radius / 50, radius * 50);
    camera.position.copy(centre).addScaledVector(new THREE.Vector3(0.5, 0.4, 1).normalize(), radius * 2.9);
    camera.lookAt(centre);
    const [flat, inLight] = [THREE.MeshBasicMaterial, THREE.MeshLambertMaterial].map((kind) => sides.map((side) => {
      dress(side, kind);
      shown(side, camera, null);
      return pixels();
    }));
    const size = Math.max(...['x', 'y', 'z'].map((axis) => Math.abs(extent[axis] - other[axis]))) / Math.max(...extent.toArray());
    const [psnr, cover] = compared(...flat), [lit] = compared(...inLight);
    row = { psnr, lit, cover, size };
    for (const side of sides) {
      shown(side, camera, new THREE.Color(0x777777));
      const picture = new Image(${SIDE}, ${SIDE});
      picture.src = renderer.domElement.toDataURL();
      picture.style.float = 'left';
      cell.append(picture);
      side.model.traverse((one) => one.geometry?.dispose());
    }
  } catch (error) {
    row = { error: String(error.message ?? error).slice(0, 200) };
  }
  const decibels = (value) => value === null ? 'the same' : value.toFixed(1) + ' dB';
  const told = row.error ?? \`flat \${decibels(row.psnr)}, lit \${decibels(row.lit)}\`;
  cell.append(Object.assign(document.createElement('p'), { textContent: text + ' \\u00b7 ' + told, style: 'clear:both' }));
  return row;
}
window.sheet = async (pairs) => {
  document.body.replaceChildren();
  const rows = [];
  for (const pair of pairs) rows.push(await draw(pair));
  return rows;
};
</script>`;

const [list, out] = process.argv.slice(2);
const { root, pairs } = JSON.parse(await readFile(list, 'utf-8'));
await withPage(PAGE, root, async (browser, address) => {
  const rows = [];
  for (let begin = 0; begin < pairs.length; begin += SHEET) {
    const page = await browser.newPage({ viewport: { width: COLUMNS * (2 * SIDE + 8), height: Math.ceil(SHEET / COLUMNS) * (SIDE + 50) } });
    page.setDefaultTimeout(SHEET * 2 * SECONDS * 1000);
    await page.goto(address);
    await page.waitForFunction(() => window.sheet);
    rows.push(...await page.evaluate((some) => window.sheet(some), pairs.slice(begin, begin + SHEET)));
    await page.screenshot({ path: path.join(out, `sheet-${String(begin / SHEET + 1).padStart(2, '0')}.png`) });
    await page.close();
    await writeFile(path.join(out, 'pairs.json'), JSON.stringify(rows));
  }
});
