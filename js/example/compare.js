/**
 * Two pictures by one camera, a .texf left of a line and a .glb right of it. Files are dropped, opened, or named in the address:
 * index.html?texf=scan.texf&glb=scan.glb
 */

import * as THREE from 'three';
import {OrbitControls} from 'three/addons/controls/OrbitControls.js';
import {RoomEnvironment} from 'three/addons/environments/RoomEnvironment.js';
import {MeshoptDecoder} from 'three/addons/libs/meshopt_decoder.module.js';
import {DRACOLoader} from 'three/addons/loaders/DRACOLoader.js';
import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
import {TEXFLoader, disposeGroup} from 'texf/three';

const byId = (id) => document.getElementById(id), stage = byId('stage'), line = byId('line');
const renderer = new THREE.WebGLRenderer({antialias: true});
const camera = new THREE.PerspectiveCamera(35, 1), controls = new OrbitControls(camera, renderer.domElement);
const environment = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment(), 0.04).texture;
const draco = new DRACOLoader().setDecoderPath(import.meta.resolve('three/addons/libs/draco/gltf/'));
const gltf = new GLTFLoader().setDRACOLoader(draco).setMeshoptDecoder(MeshoptDecoder), texf = new TEXFLoader().preload();
const sides = {texf: sideOf(), glb: sideOf()};
let share = 0.5, framed = false, asked = 0;

function sideOf() {
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0x8d949b);
  scene.environment = environment;
  return {scene, shown: null, facts: null, load: 0};
}

// ---- Drawing, when something has changed

function draw() {
  asked ||= requestAnimationFrame(() => {
    asked = 0;
    picture();
  });
}

function picture() {
  const {clientWidth: width, clientHeight: height} = stage, at = Math.round(share * width);
  renderer.setScissorTest(true);
  for (const [side, left, right] of [[sides.texf, 0, at], [sides.glb, at, width]]) {
    if (right <= left) continue;
    renderer.setScissor(left, 0, right - left, height);
    renderer.render(side.scene, camera);
  }
}

function resized() {
  const {clientWidth: width, clientHeight: height} = stage;
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(width, height, false);
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
  picture();
}

function frame() {
  const shown = sides.texf.shown ?? sides.glb.shown;
  if (!shown) return;
  const {center, radius} = new THREE.Box3().setFromObject(shown).getBoundingSphere(new THREE.Sphere());
  const narrow = Math.atan(Math.tan(camera.fov * Math.PI / 360) * Math.min(1, camera.aspect)), far = radius / Math.sin(narrow);
  camera.near = radius / 100;
  camera.far = 20 * radius;
  camera.position.copy(center).add(new THREE.Vector3(0.45, 0.25, 1).normalize().multiplyScalar(far));
  camera.updateProjectionMatrix();
  controls.target.copy(center);
  controls.update();
  framed = true;
  draw();
}

// ---- Files

/** Shows a group on its side, and frees what stood there. */
function show(side, group) {
  if (side.shown) {
    side.scene.remove(side.shown);
    free(side.shown);
  }
  side.shown = group;
  side.scene.add(group);
  byId('hint').classList.add('gone');
  if (!framed) frame();
  picture();
}

function free(group) {
  group.traverse(({material}) => {
    for (const one of [material ?? []].flat()) for (const map of Object.values(one)) if (map?.isTexture) map.dispose();
  });
  disposeGroup(group);
}

/** Loads a file: `bytes` is a function that fetches it. */
async function load(kind, name, bytes) {
  const side = sides[kind], number = ++side.load, begin = performance.now(), took = () => performance.now() - begin;
  const late = () => number !== side.load; // another file has taken the place
  byId('error').textContent = '';
  byId(`${kind}-facts`).textContent = `Loading ${name} …`;
  try {
    const data = await bytes(), facts = {name, bytes: data.byteLength};
    const seen = (group) => {
      if (late()) return free(group);
      show(side, group);
      facts.first ??= took();
      facts.whole = took();
      side.facts = facts;
      return say();
    };
    if (kind === 'texf') {
      let coarse = true;
      texf.setOnLevel((group) => coarse ? seen(group) : free(group));
      seen(await texf.parseAsync(data).finally(() => { coarse = false; }));
    } else seen((await gltf.parseAsync(data, '')).scene);
  } catch (error) {
    if (late()) return;
    say();
    byId('error').textContent = `${name}: ${error.message}`;
  }
}

function open(files) {
  for (const kind of ['texf', 'glb']) {
    const file = [...files].find((one) => one.name.toLowerCase().endsWith(`.${kind}`));
    if (!file) continue;
    framed = false;
    load(kind, file.name, () => file.arrayBuffer());
  }
  if (![...files].some((file) => /\.(texf|glb)$/i.test(file.name))) byId('error').textContent = 'These are neither .texf nor .glb files';
}

function fetched(kind, url) {
  return load(kind, url.split('/').pop(), async () => {
    const response = await fetch(url);
    if (!response.ok) throw new Error(`the server answers ${response.status}`);
    return response.arrayBuffer();
  });
}

// ---- Words

const seconds = (ms) => `${(ms / 1000).toFixed(ms < 9950 ? 2 : 1)} s`;

function say() {
  for (const [kind, {facts}] of Object.entries(sides)) {
    if (!facts) {
      byId(`${kind}-facts`).textContent = `No .${kind} yet`;
      continue;
    }
    const {name, bytes, first, whole} = facts, bold = document.createElement('b');
    bold.textContent = `${bytes.toLocaleString('en')} bytes`;
    byId(`${kind}-facts`).replaceChildren(bold, `, first picture ${seconds(first)}${whole > first ? `, whole ${seconds(whole)}` : ''}`, document.createElement('br'), name);
  }
  const [one, other] = [sides.texf.facts?.bytes, sides.glb.facts?.bytes];
  byId('ratio').textContent = one && other ? (other > one ? `${(other / one).toFixed(1)} times smaller` : `${(one / other).toFixed(1)} times greater`) : '';
}

// ---- Hands

function moveTo(where) {
  share = Math.min(1, Math.max(0, where));
  line.style.left = `${100 * share}%`;
  line.setAttribute('aria-valuenow', Math.round(100 * share));
  line.setAttribute('aria-valuetext', `${Math.round(100 * share)} % .texf`);
  draw();
}

const KEYS = {ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1};
line.addEventListener('keydown', (event) => {
  if (!(event.key in KEYS)) return;
  event.preventDefault();
  event.stopPropagation();
  moveTo(share + KEYS[event.key]);
});
line.addEventListener('pointerdown', (event) => line.setPointerCapture(event.pointerId));
line.addEventListener('pointermove', (event) => {
  if (!line.hasPointerCapture(event.pointerId)) return;
  const {left, width} = stage.getBoundingClientRect();
  moveTo((event.clientX - left) / width);
});
byId('open').addEventListener('click', () => byId('files').click());
byId('files').addEventListener('change', (event) => open(event.target.files));
byId('view').addEventListener('click', frame);
for (const name of ['dragenter', 'dragover']) addEventListener(name, (event) => {
  event.preventDefault();
  stage.classList.add('over');
});
addEventListener('dragleave', (event) => event.relatedTarget ?? stage.classList.remove('over'));
addEventListener('drop', (event) => {
  event.preventDefault();
  stage.classList.remove('over');
  open(event.dataTransfer.files);
});
addEventListener('pagehide', () => texf.dispose());

// The canvas is turned with the arrow keys where it has the focus.
renderer.domElement.tabIndex = 0;
renderer.domElement.setAttribute('aria-label', 'The mesh twice; arrow keys turn it, plus and minus come nearer and go back');
renderer.domElement.setAttribute('role', 'application');
const TURNS = {ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], '+': [0, 0, 0.9], '-': [0, 0, 1.1]};
renderer.domElement.addEventListener('keydown', (event) => {
  if (!(event.key in TURNS)) return;
  event.preventDefault();
  const [across, down, nearer] = TURNS[event.key], from = new THREE.Spherical().setFromVector3(camera.position.clone().sub(controls.target));
  from.set(from.radius * nearer, from.phi + down, from.theta + across).makeSafe();
  camera.position.setFromSpherical(from).add(controls.target);
  controls.update();
  draw();
});
stage.prepend(renderer.domElement);
controls.addEventListener('change', draw);
new ResizeObserver(resized).observe(stage);
moveTo(0.5);

const address = new URLSearchParams(location.search);
for (const kind of ['texf', 'glb']) if (address.get(kind)) fetched(kind, address.get(kind));
