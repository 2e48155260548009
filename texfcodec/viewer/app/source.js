// Where files come from: the page's server, the page itself if it was exported (viewer/page.py), or someone who drops them.

import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
import {TEXFStreamExtension} from 'texf/gltf';
import {TEXFLoader} from 'texf/three';
import WORKER from 'texf/worker-text';

import {Asset} from './asset.js';

const SIGNATURE = [0x89, 0x54, 0x58, 0x46, 0x0d, 0x0a, 0x1a, 0x0a], GLB = [0x67, 0x6c, 0x54, 0x46];
const EXTENSION = 'TEXF_stream'; // whose GLBs hold streams
const ALONE = 'This page stands alone and reads .texf and .glb files; texf-view reads other meshes.';
const beginsWith = (data, bytes) => bytes.every((byte, i) => new Uint8Array(data, 0, Math.min(8, data.byteLength))[i] === byte);

export class Source {
  static async open() {
    const held = globalThis.texfHeld ?? null; // of an exported page: (name) => Promise of an ArrayBuffer
    return new Source(held ? JSON.parse(document.getElementById('about').textContent) : await (await answerOf('about')).json(), held);
  }

  /** about: what the page knows of itself (server.about_page). */
  constructor(about, own) {
    this.about = about;
    this.own = own;
    this.texf = new TEXFLoader().setLimits(about.limits).setWorkerPath(URL.createObjectURL(new Blob([WORKER], {type: 'text/javascript'})));
    this.gltf = new GLTFLoader().register((parser) => new TEXFStreamExtension(parser, {decoder: this.texf.decoder, limits: about.limits}));
  }

  bytes(name, path) {
    return this.own ? this.own(name) : answerOf(path).then((answer) => answer.arrayBuffer());
  }

  /** ArrayBuffer of an asset that the page was made for. */
  held(number) {
    return this.bytes(`asset-${number}`, `asset/${number}`);
  }

  /** The Asset of a stream or a GLB (ArrayBuffer). facts: {name, bytes, warnings}. */
  async load(data, facts) {
    if (!beginsWith(data, SIGNATURE)) return this.mesh(data, facts);
    await this.ready();
    return new Asset(await this.texf.parseAsync(data), {...facts, kind: 'stream'});
  }

  /** Fetches the decoder. */
  ready() {
    this.wasm ??= this.bytes('decoder', 'web/texf_simd.wasm').then((wasm) => this.texf.setDecoderPath(wasm));
    return this.wasm;
  }

  async mesh(data, facts) {
    if (jsonText(data).includes(EXTENSION)) await this.ready();
    const gltf = await this.gltf.parseAsync(data, ''), scene = gltf.scene ?? gltf.scenes[0];
    if (!scene) throw new Error('the file has no scene');
    const warnings = gltf.asset.extras?.texf?.warnings ?? []; // of a mesh that the server has read
    return new Asset(scene, {...facts, kind: 'mesh', clips: gltf.animations, warnings: [...facts.warnings, ...warnings]});
  }

  /** The Asset of a file that someone drops. Throws an Error whose message says what is wrong. */
  async open(file) {
    const data = await file.arrayBuffer(), facts = {name: file.name, bytes: file.size, warnings: []};
    try {
      if (beginsWith(data, SIGNATURE)) return await this.load(data, facts);
      if (!this.about.drop && !beginsWith(data, GLB)) throw new Error(ALONE);
      const shown = beginsWith(data, GLB) ? await this.mesh(data, facts).catch((error) => error) : null;
      if (shown instanceof Asset) return shown;
      if (!this.about.drop) throw shown; // else the server reads what GLTFLoader does not, or says what is wrong
      return await this.mesh(await readByServer(file), facts);
    } catch (error) {
      throw new Error(`${file.name} is not shown. ${sentence(error)}`, {cause: error});
    }
  }
}

/** The JSON text of a GLB. */
function jsonText(data) {
  return data.byteLength < 20 ? '' : new TextDecoder().decode(data.slice(20, 20 + new DataView(data).getUint32(12, true)));
}

/** The GLB that the server makes of a mesh. */
async function readByServer(file) {
  const answer = await fetch(`drop?name=${encodeURIComponent(file.name)}`, {method: 'POST', body: file}).catch(() => {
    throw new Error('The server does not answer: has texf-view ended?');
  });
  if (answer.ok) return answer.arrayBuffer();
  const {code, message} = await answer.json().catch(() => ({}));
  throw new Error(code ? `${code}: ${message}` : `The server answers ${answer.status}`);
}

async function answerOf(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path} answers ${answer.status}`);
  return answer;
}

/** What is wrong, as a sentence. */
function sentence({message}) {
  const text = message ? message[0].toUpperCase() + message.slice(1) : 'Something has failed';
  return /[.!?]$/.test(text) ? text : `${text}.`;
}
