// Sources and decoded meshes beside each other, drawn by three.js in a browser without a window, 20 pairs a sheet.
// node pictures.mjs PAIRS.json OUT_FOLDER, in a folder where node finds three and playwright-core, with a Chromium at $CHROMIUM or
// /usr/bin/chromium. PAIRS.json: {"root", "pairs": [{"source", "mesh", "text", "linear", "unit"}]}, paths below root; linear: whether
// numbers of a source's material file are linear; unit: of a 3MF file in metres, which ThreeMFLoader leaves out, with its axis. Writes sheet-NN.png, and pairs.json: a row for each pair: "flat", "lit" and "full": dB of both pictures in two views, in flat colours, in light, and with all maps (null:
// the same), over what either covers, on grey; "inner": the least of them over what both cover; "cover": pixels that both cover of
// those that either does; "size": how far their boxes differ, of the source's; "absent": textures that are not there; "made": whether the source's normals
// are made up, by three.js in another way than by texfcodec; or "error".

import { readFile, readdir, writeFile } from 'node:fs/promises';
import path from 'node:path';
import { IMPORTS, withPage } from '../three_page.mjs';

const SIDE = 240, COLUMNS = 4, SHEET = 20, SECONDS = 60, GREY = 119;

const PAGE = `<!doctype html><meta charset="utf-8"><style>
body { margin: 0; font: 11px sans-serif; display: grid; grid-template-columns: repeat(${COLUMNS}, ${2 * SIDE + 8}px); background: #fff; }
div { padding: 4px; overflow: hidden; } p { margin: 0; height: 42px; overflow-wrap: anywhere; } img { display: block; }
</style><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';
import { RoomEnvironment } from 'three/addons/environments/RoomEnvironment.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
import { OBJLoader } from 'three/addons/loaders/OBJLoader.js';
import { MTLLoader } from 'three/addons/loaders/MTLLoader.js';
import { STLLoader } from 'three/addons/loaders/STLLoader.js';
import { PLYLoader } from 'three/addons/loaders/PLYLoader.js';
import { ColladaLoader } from 'three/addons/loaders/ColladaLoader.js';
import { TGALoader } from 'three/addons/loaders/TGALoader.js';
import { ThreeMFLoader } from 'three/addons/loaders/3MFLoader.js';
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true, alpha: true });
renderer.setSize(${SIDE}, ${SIDE});
const draco = new DRACOLoader().setDecoderPath('/three/examples/jsm/libs/draco/gltf/');
const ktx2 = new KTX2Loader().setTranscoderPath('/three/examples/jsm/libs/basis/').detectSupport(renderer);
const room = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment(), 0.04).texture;
const reader = () => new GLTFLoader().setDRACOLoader(draco).setKTX2Loader(ktx2).setMeshoptDecoder(MeshoptDecoder);
const gltf = async (url) => (await reader().loadAsync(url)).scene;
const bare = (loader) => async (url) => {
  const geometry = await loader.loadAsync(url);
  for (const [name, { array, itemSize }] of Object.entries(geometry.attributes)) {  // WebGL takes no doubles
    if (array instanceof Float64Array) geometry.setAttribute(name, new THREE.Float32BufferAttribute(array, itemSize));
  }
  if (!geometry.getAttribute('normal')) Object.assign(geometry, { isMadeUp: true }).computeVertexNormals();
  return new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ vertexColors: geometry.hasAttribute('color') }));
};
const READERS = {
  glb: gltf, gltf, stl: bare(new STLLoader()), ply: bare(new PLYLoader()), '3mf': (url) => new ThreeMFLoader().loadAsync(url),
  async obj(url) {
    const whole = await (await fetch(url)).text(), loader = new OBJLoader(), all = {};
    const text = whole.replace(/^[lp]\\s.*$/gm, '');  // OBJLoader draws an object that has lines as lines alone
    for (const [, name] of text.matchAll(/^mtllib\\s+(.+?)\\s*$/gm)) {
      const library = (url.slice(0, url.lastIndexOf('/') + 1) + name.replace(/\\\\/g, '/')).replace(/#/g, '%23');
      const folder = library.slice(0, library.lastIndexOf('/') + 1);
      const materials = await new MTLLoader().setPath(folder).loadAsync(library.slice(folder.length)).catch(() => null);
      if (!materials) continue;
      materials.preload();
      Object.assign(all, materials.materials);
      loader.setMaterials(Object.assign(materials, { materials: all }));
    }
    return Object.assign(loader.parse(text), { isMadeUp: !/^vn\\s/m.test(text) });  // normals of faces, where texfcodec's are smooth
  },
  dae: async (url) => (await new ColladaLoader().loadAsync(url)).scene,
};
THREE.DefaultLoadingManager.addHandler(/\\.tga$/i, new TGALoader());
let pending = 0;
const { itemStart, itemEnd } = THREE.DefaultLoadingManager;
Object.assign(THREE.DefaultLoadingManager, { itemStart(url) { pending++; itemStart(url); }, itemEnd(url) { pending--; itemEnd(url); } });
async function idle() {  // images come after their model
  for (let i = 0; i < 20 * ${SECONDS} && pending > 0; i++) await new Promise((done) => setTimeout(done, 50));
}
function linearised(model) {  // numbers as Blender writes them; three.js has read them as sRGB
  const done = new Set();
  model.traverse(({ material }) => [material ?? []].flat().forEach((own) => {
    if (!done.has(own)) [own.color, own.emissive].forEach((colour) => colour?.convertLinearToSRGB());
    done.add(own);
  }));
}
function hasMadeUp(model, isGltf) {
  let any = Boolean(model.isMadeUp);
  model.traverse(({ geometry: of }) => { any ||= Boolean(of && !isGltf && (of.isMadeUp || !of.getAttribute('normal'))); });
  return any;
}
async function load(file, isLinear, unit) {
  const suffix = file.split('.').pop().toLowerCase();
  if (!READERS[suffix]) throw new Error('three.js reads no .' + suffix);
  const late = new Promise((_, fail) => setTimeout(() => fail(new Error('took longer than ${SECONDS} s')), ${SECONDS * 1000}));
  const model = await Promise.race([READERS[suffix]('/cache/' + file.split('/').map(encodeURIComponent).join('/')), late]);
  await idle();
  if (isLinear) linearised(model);
  if (suffix === '3mf') {
    model.rotation.x = -Math.PI / 2;
    model.scale.setScalar(unit ?? 1);
  }
  const scene = Object.assign(new THREE.Scene(), { environmentIntensity: 0.4 }), sun = new THREE.DirectionalLight(0xffffff, 1.5);
  sun.position.set(1, 2, 3);
  scene.add(model, sun, new THREE.HemisphereLight(0xffffff, 0x404040, 0.8));
  const isGltf = suffix === 'glb' || suffix === 'gltf', isMadeUp = suffix === 'stl' || suffix === '3mf' || hasMadeUp(model, isGltf);
  return { scene, model, isGltf, isMadeUp, absent: withoutAbsent(model) };
}
const PLAIN = ['map', 'alphaMap', 'color', 'side', 'alphaTest', 'transparent', 'opacity'];
const MAPS = ['normalMap', 'normalScale', 'bumpMap', 'bumpScale', 'emissive', 'emissiveMap', 'emissiveIntensity', 'aoMap', 'aoMapIntensity'];
const GLOSS = ['roughness', 'metalness', 'roughnessMap', 'metalnessMap'];
function withoutAbsent(model) {  // a texture that did not come is no texture, rather than a black one
  let count = 0;
  model.traverse(({ material }) => [material ?? []].flat().forEach((own) => [...PLAIN, ...MAPS, ...GLOSS].forEach((slot) => {
    if (!own[slot]?.isTexture || own[slot].image?.width || own[slot].image?.data || own[slot].isCompressedTexture) return;
    own[slot] = null;
    count++;
  })));
  return count;
}
// One material in place of each loader's, so that two loaders can be compared: ColladaLoader forgets colours of vertices, and normals
// that are not there. Gloss is a thing of glTF alone.
function dress({ model }, kind, hasGloss) {
  const Kind = { flat: THREE.MeshBasicMaterial, lit: THREE.MeshLambertMaterial, full: THREE.MeshStandardMaterial }[kind];
  const dressed = (own, geometry) => {
    if (kind === 'full' && hasGloss && own.isMeshStandardMaterial || own.isMeshBasicMaterial && kind !== 'flat') return own;
    const slots = [...PLAIN, ...kind === 'full' ? [...MAPS, ...hasGloss ? GLOSS : []] : []];
    const values = Object.fromEntries(slots.filter((slot) => own[slot] !== undefined).map((slot) => [slot, own[slot]]));
    const normals = kind === 'flat' ? {} : { flatShading: own.flatShading || !geometry.hasAttribute('normal') };
    return new Kind({ ...values, vertexColors: geometry.hasAttribute('color'), ...normals });
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
const decibels = (squares, count) => squares === 0 ? null : 10 * Math.log10(255 ** 2 * 3 * count / squares);
function compared(a, b) {  // pixels with alpha, premultiplied: on grey
  let squares = 0, inside = 0, count = 0, whole = 0, both = 0, either = 0;
  for (let i = 0; i < a.length; i += 4) {
    if (!(a[i + 3] || b[i + 3])) continue;
    const are = a[i + 3] === 255 && b[i + 3] === 255;
    count++;
    whole += are;
    both += a[i + 3] > 127 && b[i + 3] > 127;
    either += a[i + 3] > 127 || b[i + 3] > 127;
    for (let c = 0; c < 3; c++) {
      const square = (a[i + c] - b[i + c] + (b[i + 3] - a[i + 3]) * ${GREY} / 255) ** 2;
      squares += square;
      inside += are ? square : 0;
    }
  }
  return { union: decibels(squares, count), inner: decibels(inside, whole), cover: either ? both / either : null };
}
const least = (values) => values.reduce((a, b) => a === null ? b : b === null ? a : Math.min(a, b), null);
function cameras(box) {
  const centre = box.getCenter(new THREE.Vector3()), radius = box.getSize(new THREE.Vector3()).length() / 2 || 1;
  return [[0.5, 0.4, 1], [-0.8, -0.3, -0.7]].map((way) => {
    const camera = new THREE.PerspectiveCamera(40, 1, radius / 50, radius * 50);
    camera.position.copy(centre).addScaledVector(new THREE.Vector3(...way).normalize(), radius * 2.9);
    camera.lookAt(centre);
    return camera;
  });
}
function measured(sides, views) {
  const row = { inner: null, cover: 1 }, hasGloss = sides.every((side) => side.isGltf);
  for (const kind of ['flat', 'lit', 'full']) {
    for (const side of sides) {
      dress(side, kind, hasGloss);
      side.scene.environment = kind === 'full' ? room : null;
    }
    const all = views.map((camera) => compared(...sides.map((side) => { shown(side, camera, null); return pixels(); })));
    row[kind] = least(all.map(({ union }) => union));
    row.inner = least([row.inner, ...all.map(({ inner }) => inner)]);
    row.cover = Math.min(row.cover, ...all.map(({ cover }) => cover ?? 1));
  }
  return row;
}
async function draw({ source, mesh, text, linear, unit }) {
  const cell = document.createElement('div');
  document.body.append(cell);
  let row;
  try {
    const sides = [await load(source, linear, unit), await load(mesh, false)], boxes = sides.map(({ model }) => new THREE.Box3().setFromObject(model, true));
    if (boxes[0].isEmpty()) throw new Error('three.js shows nothing of the source');
    const [extent, other] = boxes.map((box) => box.getSize(new THREE.Vector3())), views = cameras(boxes[0]);
    const size = Math.max(...['x', 'y', 'z'].map((axis) => Math.abs(extent[axis] - other[axis]))) / Math.max(...extent.toArray());
    row = { ...measured(sides, views), size, absent: sides[0].absent, made: sides[0].isMadeUp };
    for (const side of sides) {
      shown(side, views[0], new THREE.Color(0x777777));
      const picture = new Image(${SIDE}, ${SIDE});
      picture.src = renderer.domElement.toDataURL();
      picture.style.float = 'left';
      cell.append(picture);
    }
    for (const side of sides) side.model.traverse((object) => {
      object.geometry?.dispose();
      for (const own of [object.own ?? []].flat()) [...PLAIN, ...MAPS, ...GLOSS].forEach((slot) => own[slot]?.isTexture && own[slot].dispose());
    });
  } catch (error) {
    row = { error: String(error.message ?? error).slice(0, 200) };
  }
  const figure = (kind) => kind + ' ' + (row[kind] === null ? 'the same' : row[kind].toFixed(1) + ' dB');
  const line = row.error ?? ['flat', 'lit', 'full'].map(figure).join(', ');
  cell.append(Object.assign(document.createElement('p'), { textContent: text + ' \\u00b7 ' + line, style: 'clear:both' }));
  return row;
}
window.sheet = async (pairs) => {
  document.body.replaceChildren();
  const rows = [];
  for (const pair of pairs) rows.push(await draw(pair));
  return rows;
};
</script>`;

// A file that is not where its model says: of that name, whatever its case, beside or below the package's folder (files/KIND/PACKAGE).
async function elsewhere(file, root) {
  const [files, kind, name] = path.relative(root, file).split(path.sep), folder = path.join(root, files, kind ?? '', name ?? '');
  const wanted = file.split(/[\\/]/).pop().toLowerCase(), all = await readdir(folder, { recursive: true }).catch(() => []);
  const there = all.find((entry) => path.basename(entry).toLowerCase() === wanted);
  return there && /\.(png|jpe?g|bmp|gif|webp|tga|mtl|bin)$/i.test(there) ? readFile(path.join(folder, there)) : null;
}

const [list, out] = process.argv.slice(2);
const { root, pairs } = JSON.parse(await readFile(list, 'utf-8'));
await withPage(PAGE, root, async (browser, address) => {
  const rows = [];
  for (let begin = 0; begin < pairs.length; begin += SHEET) {
    const page = await browser.newPage({ viewport: { width: COLUMNS * (2 * SIDE + 8), height: Math.ceil(SHEET / COLUMNS) * (SIDE + 50) } });
    const some = pairs.slice(begin, begin + SHEET);
    page.setDefaultTimeout(SHEET * 2 * SECONDS * 1000);
    try {
      await page.goto(address);
      await page.waitForFunction(() => window.sheet);
      rows.push(...await page.evaluate((chosen) => window.sheet(chosen), some));
      await page.screenshot({ path: path.join(out, `sheet-${String(begin / SHEET + 1).padStart(2, '0')}.png`) });
    } catch (error) {
      rows.push(...some.slice(rows.length - begin).map(() => ({ error: String(error.message).slice(0, 200) })));
    }
    await page.close();
    await writeFile(path.join(out, 'pairs.json'), JSON.stringify(rows));
  }
}, { elsewhere });
