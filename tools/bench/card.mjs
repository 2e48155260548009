// What three.js keeps on the graphics card of files, and what a frame of them costs, in a browser without a window and without a card.
// node card.mjs JOBS.json in a folder where node finds three and playwright-core. JOBS.json: [{"file": a .texf or .glb, "hidden": parts
// of the names of extensions that the card is to lack, "blocks": whether a stream's textures are compressed, ...}]. Prints a line of JSON
// for each: the job and {"textures", "texture_bytes", "buffer_bytes", "frame_ms", "formats"}; of blocks also "psnr", of each texture by the
// browser's own decoder, and "blocks_ms". Bytes are those that three.js asks of WebGL; milliseconds are of the processor.

import { readFileSync } from 'node:fs';
import path from 'node:path';
import { IMPORTS, withPage } from '../proof/three_page.mjs';

const REPOSITORY = path.resolve(import.meta.dirname, '../..'), SIZE = 512, FRAMES = 12;

const PAGE = `<!doctype html><meta charset="utf-8"><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';
import { decode } from '/cache/js/src/index.js';
import { compressed, groupOf, TEXFLoader } from '/cache/js/src/three.js';

const BITS = { 0x8058: 32, 0x8C43: 32, 0x8051: 24, 0x8229: 8, 0x822B: 16, 0x822F: 32, 0x823C: 64, 0x8236: 32, 0x822E: 32, 0x8230: 64, 0x881A: 64, 0x8814: 128,
  0x8D70: 128, 0x8D7C: 32, 0x823A: 32, 0x8E8C: 8, 0x8E8D: 8, 0x93B0: 8, 0x93D0: 8, 0x9274: 4, 0x9275: 4, 0x9278: 8, 0x9279: 8 };
const BLOCKS = (format) => (format >= 0x8E8C && format <= 0x8E8F) || (format >= 0x9270 && format <= 0x93DF);
const held = { textures: 0, texture_bytes: 0, buffer_bytes: 0, formats: {} };
const gl2 = WebGL2RenderingContext.prototype, { texStorage2D, bufferData, getExtension } = gl2;
gl2.texStorage2D = function (target, levels, format, width, height) {
  texStorage2D.call(this, target, levels, format, width, height);
  if (!(format in BITS)) throw new Error('texture format 0x' + format.toString(16));
  const side = (length, n) => (BLOCKS(format) ? 4 * Math.ceil(Math.max(1, length >> n) / 4) : Math.max(1, length >> n));
  for (let n = 0; n < levels; n++) held.texture_bytes += side(width, n) * side(height, n) * BITS[format] / 8;
  held.textures += 1;
  held.formats['0x' + format.toString(16)] = (held.formats['0x' + format.toString(16)] ?? 0) + 1;
};
gl2.bufferData = function (target, data, ...others) {
  bufferData.call(this, target, data, ...others);
  held.buffer_bytes += data.byteLength ?? data;
};
window.hide = (hidden) => {
  gl2.getExtension = function (name) { return hidden.some((part) => name.includes(part)) ? null : getExtension.call(this, name); };
};

let renderer, scene, camera, object, asset, blocks;
const loader = new TEXFLoader();
window.prepare = async (file, wantsBlocks) => {
  renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
  renderer.setSize(${SIZE}, ${SIZE});
  scene = new THREE.Scene();
  const bytes = await (await fetch('/file/' + file)).arrayBuffer(), lamp = new THREE.DirectionalLight(0xffffff, 2.5);
  lamp.position.set(1, 2, 3);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x666655, 1.5), lamp);
  if (file.endsWith('.texf')) {
    if (wantsBlocks) asset = await decode(bytes);
    if (wantsBlocks) loader.detectSupport(renderer);
    object = () => loader.parseAsync(bytes);
  } else {
    const ktx2 = new KTX2Loader().setTranscoderPath('/three/examples/jsm/libs/basis/').detectSupport(renderer);
    object = async () => (await new GLTFLoader().setKTX2Loader(ktx2).parseAsync(bytes, '')).scene;
  }
};
window.encode = async () => { blocks = await compressed(asset, loader.decoder, loader.blockFormat); };
window.show = async () => {
  const shown = await object();
  scene.add(shown);
  const sphere = new THREE.Box3().setFromObject(shown, true).getBoundingSphere(new THREE.Sphere());
  camera = new THREE.PerspectiveCamera(35, 1, 0.01 * sphere.radius, 20 * sphere.radius);
  camera.position.set(2, 1.2, 2.6).setLength(3.6 * sphere.radius).add(sphere.center);
  camera.lookAt(sphere.center);
  window.frames_(2);
  return held;
};
window.frames_ = (count) => { // the last is waited for
  const gl = renderer.getContext();
  for (let n = 0; n < count; n++) {
    scene.rotation.y += 0.1;
    renderer.render(scene, camera);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
};
function texelsOf(texture, width, height) {
  const target = new THREE.WebGLRenderTarget(width, height), out = new Uint8Array(4 * width * height);
  const material = new THREE.ShaderMaterial({ glslVersion: THREE.GLSL3, uniforms: { map: { value: texture } }, depthTest: false,
    vertexShader: 'void main() { gl_Position = vec4(position.xy * 2.0, 0.0, 1.0); }',
    fragmentShader: 'uniform sampler2D map; out vec4 texel; void main() { texel = texelFetch(map, ivec2(gl_FragCoord.xy), 0); }' });
  const quad = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
  quad.frustumCulled = false;
  texture.colorSpace = THREE.NoColorSpace;
  renderer.setRenderTarget(target);
  renderer.render(quad, camera);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, out);
  renderer.setRenderTarget(null);
  target.dispose();
  return out;
}
window.quality = () => { // of each texture in blocks: the maps it is, and PSNR of each component that they take
  const plain = groupOf(asset).userData.textures, coded = groupOf(asset, blocks), names = new Map();
  coded.traverse(({ material }) => Object.entries(material ?? {}).forEach(([name, value]) => value?.isTexture && names.set(value, [...(names.get(value) ?? []), name])));
  return coded.userData.textures.flatMap((texture, n) => {
    if (!texture.isCompressedTexture) return [];
    const { data, width, height } = plain[n].image, out = texelsOf(texture, width, height), psnr = [];
    for (let k = 0; k < 4; k++) {
      let sum = 0, varies = false;
      for (let i = k; i < data.length; i += 4) {
        sum += (data[i] - out[i]) ** 2;
        varies ||= data[i] !== 255;
      }
      if (varies) psnr.push(10 * Math.log10(255 * 255 * width * height / Math.max(sum, 1e-3)));
    }
    return [{ maps: [...new Set(names.get(texture))], psnr }];
  });
};
window.ready = true;
</script>`;

async function processorOf(session, type) {
  const { processInfo } = await session.send('SystemInfo.getProcessInfo');
  return processInfo.filter((process) => process.type === type).reduce((sum, process) => sum + process.cpuTime, 0);
}

async function measured(browser, address, { file, hidden, blocks }, number) {
  const context = await browser.newContext(), page = await context.newPage(), session = await browser.newBrowserCDPSession(), said = [];
  page.on('console', (message) => !/GPU stall/.test(message.text()) && said.push(message.text()));
  page.on('pageerror', (error) => said.push(String(error)));
  try {
    await page.goto(address, { waitUntil: 'load' });
    await page.waitForFunction(() => window.ready);
    await page.evaluate((names) => window.hide(names), hidden);
    await page.evaluate(([name, wants]) => window.prepare(name, wants), [`${number}${path.extname(file)}`, blocks]);
    const row = {};
    if (blocks) {
      const before = await processorOf(session, 'renderer');
      await page.evaluate(() => window.encode());
      row.blocks_ms = Math.round(1000 * (await processorOf(session, 'renderer') - before));
    }
    Object.assign(row, await page.evaluate(() => window.show()));
    const before = await processorOf(session, 'GPU');
    await page.evaluate((count) => window.frames_(count), FRAMES);
    row.frame_ms = 1000 * (await processorOf(session, 'GPU') - before) / FRAMES;
    if (blocks) row.psnr = await page.evaluate(() => window.quality());
    return said.length ? { ...row, said } : row;
  } catch (error) {
    return { error: String(error), said };
  } finally {
    await context.close();
  }
}

const jobs = JSON.parse(readFileSync(process.argv[2], 'utf8'));
const routes = Object.fromEntries(jobs.map(({ file }, n) => [`/file/${n}${path.extname(file)}`, (_, response) => response.end(readFileSync(file))]));
await withPage(PAGE, REPOSITORY, async (browser, address) => {
  for (const [n, job] of jobs.entries()) console.log(JSON.stringify({ ...job, ...await measured(browser, address, job, n) }));
}, { routes });
