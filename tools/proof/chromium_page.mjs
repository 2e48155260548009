// What runs in the page of chromium.mjs: streams through the package's workers, how long that takes, and, where the page is asked for
// "?loader", TEXFLoader on what servers and users do to it.

import { CHANNELS, Engine, TexfError } from '/cache/js/src/engine.js';
import { Decoder } from '/cache/js/src/index.js';
import { EXIT, arraysOf } from '/cache/js/test/arrays.mjs';

const decoder = new Decoder();
const fetched = async (url) => new Uint8Array(await (await fetch(url)).arrayBuffer());

// The arrays of a stream: positions, faces, keys and values are what the workers give; what an asset does not hold as integers (UVs,
// sharp edges, coded normals), and coordinates that binary32 does not, are asked of a module in the page.
async function decoded(bytes, level) {
  const asset = await decoder.decode(bytes, { level }), engine = new Engine(await decoder.preload());
  engine.decode(bytes, level);
  const said = JSON.parse(new TextDecoder().decode(engine.array('description')));
  const scale = asset.side / (2 ** asset.positionBits - 1), held = scale > 2 ** -126 && asset.side < 2 ** 127; // by binary32
  const valuesOf = (i, g) => asset.fields[i].planes[CHANNELS[said.groups[g].semantics[0]]]?.values;
  return arraysOf(said, (kind, i, g) => {
    if (kind === 'faces') return asset.units[i].indices;
    if (kind === 'positions' && held) return Uint32Array.from(asset.units[i].positions, (p) => Math.round(p / scale));
    if (kind === 'keys') return asset.fields[i].keys;
    if (kind === 'values') return valuesOf(i, g) ?? new ArrayBuffer(0);
    return engine.array(kind, i, g);
  });
}

const base64 = (bytes) => {
  let text = '';
  for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  return btoa(text);
};

// Exit code, message and files in base64, as a decoder's command would give them.
async function answer(url, level) {
  try {
    const files = await decoded(await fetched(url), level);
    return { code: 0, files: Object.fromEntries(Object.entries(files).map(([name, content]) => [name, base64(content)])) };
  } catch (error) {
    return { code: error instanceof TexfError ? EXIT[error.code] : 4, files: {}, message: error.message };
  }
}

// Milliseconds to the coarse asset and to the whole, medians; workers are up and the module is compiled.
async function timed(url, times) {
  const bytes = await fetched(url), coarse = [], whole = [];
  await decoder.decode(bytes);
  for (let n = 0; n < times; n++) {
    const begin = performance.now();
    let first = null;
    await decoder.decode(bytes, { onLevel: () => { first = performance.now() - begin; } });
    whole.push(performance.now() - begin);
    coarse.push(first ?? whole.at(-1));
  }
  const median = (values) => Math.round(values.sort((a, b) => a - b)[values.length >> 1]);
  return { bytes: bytes.length, coarse: median(coarse), whole: median(whole) };
}

async function loaderChecks() {
  const THREE = await import('three'), { TEXFLoader, disposeGroup } = await import('/cache/js/src/three.js');
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
    const result = await Promise.race([
      Promise.all([loader.loadAsync(url), use(loader)]).then(([group]) => ({ meshes: group.children.length }), (error) => (
        { code: error instanceof TexfError ? error.code : error.name, message: error.message })),
      new Promise((resolve) => { setTimeout(() => resolve({ code: 'nothing happened' }), 20000); }),
    ]);
    const seconds = (performance.now() - begin) / 1000;
    loader.dispose();
    await new Promise((resolve) => { setTimeout(resolve, 100); });
    const { busy, idle, waiting } = loader.decoder;
    return { ...result, seconds, left: busy.size + idle.length + waiting.length + counts.begun - counts.ended };
  }
  const pause = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

  return {
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
}

window.check = { answer, timed, ...import.meta.url.endsWith('?loader') ? await loaderChecks() : {} };
