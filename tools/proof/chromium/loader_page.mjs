// What runs in the page of loader.mjs: TEXFLoader on what servers and users do to it.

import * as THREE from 'three';
import { TEXFLoader, TexfError, disposeGroup } from '/cache/js/src/three.js';

const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setSize(400, 400);
document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera(40, 1, 0.01, 100), scene = new THREE.Scene();
scene.background = new THREE.Color(0.5, 0.5, 0.5);
scene.add(new THREE.HemisphereLight(0xffffff, 0x888888, 3));

function drawn(group) {
  const { center, radius } = new THREE.Box3().setFromObject(group).getBoundingSphere(new THREE.Sphere());
  camera.near = radius / 100;
  camera.far = radius * 10;
  camera.position.copy(center).add(new THREE.Vector3(0.6, 0.5, 0.9).normalize().multiplyScalar(3 * radius));
  camera.lookAt(center);
  camera.updateProjectionMatrix();
  scene.add(group);
  renderer.render(scene, camera);
  const gl = renderer.getContext(), pixels = new Uint8Array(4 * 400 * 400);
  gl.readPixels(0, 0, 400, 400, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return pixels;
}

// A load of its own: what came of it, once all that a manager counts has ended.
async function outcome(url, use = () => {}) {
  const counts = { begun: 0, ended: 0 }, manager = new THREE.LoadingManager(), loader = new TEXFLoader(manager);
  const [start, end] = [manager.itemStart, manager.itemEnd];
  manager.itemStart = (item) => { counts.begun++; start(item); };
  manager.itemEnd = (item) => { counts.ended++; end(item); };
  const begin = performance.now();
  const found = await Promise.race([
    Promise.all([loader.loadAsync(url), use(loader)]).then(([group]) => ({ meshes: group.children.length }), (error) => (
      { code: error instanceof TexfError ? error.code : error.name, message: error.message })),
    new Promise((resolve) => { setTimeout(() => resolve({ code: 'nothing happened' }), 20000); }),
  ]);
  const seconds = (performance.now() - begin) / 1000;
  loader.dispose();
  await new Promise((resolve) => { setTimeout(resolve, 100); });
  const { busy, idle, waiting } = loader.decoder;
  return { ...found, seconds, left: busy.size + idle.length + waiting.length + counts.begun - counts.ended };
}
const pause = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

window.check = {
  outcome: (url) => outcome(url),
  limited: (url) => outcome(url, (loader) => loader.setLimits({ faces: 1 })),
  aborted: (url, ms) => outcome(url, async (loader) => { await pause(ms); loader.abort(); }),
  disposed: (url, ms) => outcome(url, async (loader) => { await pause(ms); loader.dispose(); }),
  // Two loaders on one address share its download; a third's is another.
  atOnce: async (url, other) => Promise.all([outcome(url), outcome(url), outcome(other)]),
  async shared(url) { // one loader, two loads, then one more after an abort
    const loader = new TEXFLoader(), both = await Promise.all([loader.loadAsync(url), loader.loadAsync(url)]);
    const late = loader.loadAsync(url).then(() => 'loaded', (error) => error.code);
    loader.abort();
    const code = await late, again = await loader.loadAsync(url);
    loader.dispose();
    return { meshes: both.map((group) => group.children.length), code, again: again.children.length };
  },
  async restored(url) {
    const loader = new TEXFLoader(), group = await loader.loadAsync(url), canvas = renderer.domElement;
    loader.dispose();
    const before = drawn(group), context = renderer.getContext().getExtension('WEBGL_lose_context');
    const heard = (name) => new Promise((resolve) => { canvas.addEventListener(name, resolve, { once: true }); });
    const lost = heard('webglcontextlost'), back = heard('webglcontextrestored');
    context.loseContext();
    await lost;
    await pause(50);
    context.restoreContext();
    await back;
    const after = drawn(group), differ = after.reduce((count, value, i) => count + (value !== before[i]), 0);
    const covered = before.reduce((count, value, i) => count + (i % 4 === 0 && value !== before[0]), 0);
    return { differ, covered };
  },
  clear() { // after a picture was taken
    for (const group of scene.children.filter((child) => child.isGroup)) {
      scene.remove(group);
      disposeGroup(group);
    }
    renderer.renderLists.dispose();
  },
  async loads(url, times) { // loads, drawings and disposals; heap is asked from outside
    const loader = new TEXFLoader();
    for (let n = 0; n < times; n++) {
      const group = await loader.loadAsync(url);
      drawn(group);
      scene.remove(group);
      disposeGroup(group);
    }
    loader.dispose();
    return { ...renderer.info.memory, programs: renderer.info.programs.length };
  },
};
