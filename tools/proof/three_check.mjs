// GLB files, or streams by TEXFLoader, drawn by three.js from given orthographic cameras in a given light, in a browser without a window.
// node three_check.mjs JOB.json OUT_FOLDER, in a folder where node finds three and playwright-core (three_page.mjs).
// JOB.json: {"root", "size", "filter": "linear" or "mipmaps", "alike": names of ALIKE, or "frames", "sky": {"width", "height", "file"} or
// null, "lights": [{"direction", "colour"}], "files": [{"name", "path", "cameras": name}], "cameras": {name: [{"right", "up",
// "forward", "eye", "half", "depth"}]}}; paths are below root, where js/src stands if there are streams; "flat": streams show their base
// colour without light. The sky's file is float32 RGBA, linear, from the nadir up. Writes
// NAME-VIEW.rgba: colour over white, sRGB-coded, and how much of a pixel is covered, rows from below; and facts.json: {"revision",
// "files": {name: what the file's geometries and materials have; of a stream also milliseconds to its coarse picture and the whole}}.

import { readFile, writeFile } from 'node:fs/promises';
import path from 'node:path';
import { IMPORTS, withPage } from './three_page.mjs';

const SECONDS = 300;

const PAGE = `<!doctype html><meta charset="utf-8"><body>${IMPORTS}<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
import * as MikkTSpace from 'three/addons/libs/mikktspace.module.js';
import { computeMikkTSpaceTangents } from 'three/addons/utils/BufferGeometryUtils.js';
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true, alpha: true });
renderer.outputColorSpace = THREE.SRGBColorSpace;
renderer.toneMapping = THREE.NoToneMapping;
renderer.setPixelRatio(1);
const draco = new DRACOLoader().setDecoderPath('/three/examples/jsm/libs/draco/gltf/');
const scene = new THREE.Scene();
let job, model;

// What three.js does otherwise than texfcodec/render, and what makes it do the same: [chunk of a shader, its text, text instead].
const TOTAL = \`vec3 lobe = material.specularColor * material.dfg.x + vec3( material.specularF90 * material.dfg.y );
  lobe *= 1.0 + material.specularColor * ( 1.0 / ( material.dfg.x + material.dfg.y ) - 1.0 );\`;
const ALIKE = {
  roughness: [['lights_physical_fragment', 'float geometryRoughness = max( max( dxy.x, dxy.y ), dxy.z );', 'float geometryRoughness = 0.0;']],
  occlusion: [['aomap_fragment', 'computeSpecularOcclusion( dotNV, ambientOcclusion, material.roughness )', 'ambientOcclusion']],
  diffuse: [['lights_physical_pars_fragment', 'reflectedLight.directDiffuse += irradiance * diffuseBRDF * ( 1.0 - F );',
    TOTAL + ' reflectedLight.directDiffuse += irradiance * diffuseBRDF * ( 1.0 - lobe );']],
  bounces: [['lights_physical_pars_fragment', 'singleScatter += FssEss;', 'singleScatter += FssEss * ( 1.0 + Fr * ( 1.0 / Ess - 1.0 ) );'],
    ['lights_physical_pars_fragment', 'multiScatter += Fms * Ems;', '']],
  mirror: [['envmap_physical_pars_fragment', 'reflectVec = normalize( mix( reflectVec, normal, pow4( roughness ) ) );',
    'reflectVec = normalize( mix( reflectVec, normal, pow2( roughness ) ) );']],
  coat: [['physical', 'vec3 Fcc = F_Schlick( material.clearcoatF0, material.clearcoatF90, dotNVcc );',
    'vec3 Fcc = EnvironmentBRDF( geometryClearcoatNormal, geometryViewDir, material.clearcoatF0, material.clearcoatF90, material.clearcoatRoughness );']],
  colours: [['map_fragment', 'diffuseColor *= sampledDiffuseColor;', 'diffuseColor *= sRGBTransferEOTF( sampledDiffuseColor );'],
    ['emissivemap_fragment', 'totalEmissiveRadiance *= emissiveColor.rgb;', 'totalEmissiveRadiance *= sRGBTransferEOTF( emissiveColor ).rgb;']],
};
function makeAlike(name) {
  for (const [chunk, text, instead] of ALIKE[name]) {
    const shader = chunk === 'physical' ? THREE.ShaderLib.physical : THREE.ShaderChunk;
    const key = chunk === 'physical' ? 'fragmentShader' : chunk;
    if (!shader[key].includes(text)) throw new Error(\`\${chunk} of this three.js does not say: \${text}\`);
    shader[key] = shader[key].replace(text, instead);
  }
}

async function skyOf({ width, height, file }) {
  const values = new Float32Array(await (await fetch('/cache/' + file)).arrayBuffer());
  const sky = new THREE.DataTexture(values, width, height, THREE.RGBAFormat, THREE.FloatType, THREE.EquirectangularReflectionMapping);
  sky.colorSpace = THREE.LinearSRGBColorSpace;
  sky.minFilter = sky.magFilter = THREE.LinearFilter;
  sky.wrapS = THREE.RepeatWrapping;
  sky.needsUpdate = true;
  return new THREE.PMREMGenerator(renderer).fromEquirectangular(sky).texture;
}
window.prepare = async (given) => {
  job = given;
  job.alike.filter((name) => ALIKE[name]).forEach(makeAlike);
  renderer.setSize(job.size, job.size);
  await MikkTSpace.ready;
  if (job.sky) scene.environment = await skyOf(job.sky);
  for (const { direction, colour } of job.lights) {
    const light = new THREE.DirectionalLight(0xffffff, 1);
    light.color.setRGB(...colour, THREE.LinearSRGBColorSpace);
    light.position.set(...direction);
    scene.add(light);
  }
  return THREE.REVISION;
};
function dressed(material) {  // as GLTFLoader makes it, but for back faces and, where asked, mip maps
  material.side = THREE.FrontSide;
  for (const map of Object.values(material)) {
    if (map?.isTexture && job.alike.includes('colours')) map.colorSpace = THREE.NoColorSpace;
    if (!map?.isTexture || job.filter !== 'linear') continue;
    map.minFilter = map.magFilter = THREE.LinearFilter;
    map.generateMipmaps = false;
    map.needsUpdate = true;
  }
}
// Frames of normal maps as glTF means them: three.js makes some of derivatives in the picture where a file brings none, and, with v the
// wrong way, where it brings them but the coat alone has a normal map (r187).
const FLAT = new THREE.DataTexture(new Float32Array([0.5, 0.5, 1, 1]), 1, 1, THREE.RGBAFormat, THREE.FloatType);
FLAT.needsUpdate = true;
function framed(mesh) {
  for (const material of [mesh.material].flat()) {
    if (!material.normalMap && !material.clearcoatNormalMap) continue;
    if (!mesh.geometry.hasAttribute('tangent')) {
      mesh.geometry = computeMikkTSpaceTangents(mesh.geometry, MikkTSpace);
      material.normalScale.y = Math.abs(material.normalScale.y);  // GLTFLoader has turned it
      if (material.clearcoatNormalScale) material.clearcoatNormalScale.y = Math.abs(material.clearcoatNormalScale.y);
    }
    material.normalMap ??= FLAT;
  }
}
async function streamOf(url, facts) {  // the second decoding is timed: workers are up then and the module is compiled
  const { decode, dispose } = await import('/cache/js/src/index.js'), { disposeGroup, groupOf } = await import('/cache/js/src/three.js');
  if (model) disposeGroup(model);
  const bytes = await (await fetch(url)).arrayBuffer();
  await decode(bytes.slice());
  const begin = performance.now(), ms = () => Math.round(performance.now() - begin);
  const asset = await decode(bytes, { onLevel: () => { facts.coarse_ms ??= ms(); } });
  facts.whole_ms = ms();
  dispose();
  if (job.flat) asset.materials.forEach((material) => { material.unlit = true; });
  return groupOf(asset);
}
window.load = async (file) => {
  if (model) scene.remove(model);
  const loader = new GLTFLoader().setDRACOLoader(draco).setMeshoptDecoder(MeshoptDecoder);
  const url = '/cache/' + file.split('/').map(encodeURIComponent).join('/');
  const facts = { meshes: 0, tangents: 0, normals: 0, materials: {} };
  model = file.endsWith('.texf') ? await streamOf(url, facts) : (await loader.loadAsync(url)).scene;
  scene.add(model);
  model.traverse((mesh) => {
    if (!mesh.isMesh) return;
    facts.meshes += 1;
    facts.normals += mesh.geometry.hasAttribute('normal');
    facts.tangents += mesh.geometry.hasAttribute('tangent');
    if (job.alike.includes('frames')) framed(mesh);
    for (const material of [mesh.material].flat()) {
      dressed(material);
      const maps = Object.keys(material).filter((key) => material[key]?.isTexture);
      facts.materials[material.name] = [material.type, ...maps].join(' ');
    }
  });
  return facts;
};
function cameraOf({ right, up, forward, eye, half, depth }) {
  const camera = new THREE.OrthographicCamera(-half, half, half, -half, -depth, 3 * depth);
  const [x, y, z] = [right, up, forward].map((axis) => new THREE.Vector3(...axis));
  camera.matrixAutoUpdate = false;
  camera.matrix.makeBasis(x, y, z.negate()).setPosition(...eye);
  camera.updateMatrixWorld(true);
  return camera;
}
function pixels(camera, background) {
  renderer.setClearColor(background, 1);
  renderer.render(scene, camera);
  const gl = renderer.getContext(), data = new Uint8Array(4 * job.size * job.size);
  gl.readPixels(0, 0, job.size, job.size, gl.RGBA, gl.UNSIGNED_BYTE, data);
  return data;
}
window.draw = (given) => {
  const camera = cameraOf(given), white = pixels(camera, 0xffffff), black = pixels(camera, 0);
  for (let i = 0; i < white.length; i += 4) {  // what the background adds is what is not covered
    white[i + 3] = 255 - Math.max(white[i] - black[i], white[i + 1] - black[i + 1], white[i + 2] - black[i + 2]);
  }
  let text = '';
  for (let i = 0; i < white.length; i += 32768) text += String.fromCharCode(...white.subarray(i, i + 32768));
  return btoa(text);
};
</script>`;

const [list, out] = process.argv.slice(2);
const job = JSON.parse(await readFile(list, 'utf-8'));
await withPage(PAGE, job.root, async (browser, address) => {
  const page = await browser.newPage(), facts = { files: {} };
  page.setDefaultTimeout(SECONDS * 1000);
  page.on('console', (message) => message.type() === 'error' && console.error(message.text()));
  await page.goto(address);
  await page.waitForFunction(() => window.draw);
  facts.revision = await page.evaluate((given) => window.prepare(given), { ...job, files: undefined, cameras: undefined });
  for (const { name, path: file, cameras } of job.files) {
    facts.files[name] = await page.evaluate((given) => window.load(given), file);
    for (const [view, camera] of job.cameras[cameras].entries()) {
      const picture = await page.evaluate((given) => window.draw(given), camera);
      await writeFile(path.join(out, `${name}-${view}.rgba`), Buffer.from(picture, 'base64'));
    }
  }
  await writeFile(path.join(out, 'facts.json'), JSON.stringify(facts));
});
