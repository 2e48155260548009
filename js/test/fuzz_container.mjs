/**
 * Fuzzes expand() by changed files of conformance/container/: an execution ends in a readable file or in a TexfError, soon and with little memory.
 *
 *     node js/test/fuzz_container.mjs [--executions 1000] [--seed 1] [--first 0] [--save FOLDER]
 *
 * Prints JSON with executions, seconds of the processor, outcomes and findings, and exits 7 with findings. Input n of a seed is always
 * the same: --first n --executions 1 runs it again. Streams are decoded by texf_simd.wasm, equal ones once, for other fuzzers are about streams.
 */

import {readFileSync, readdirSync, writeFileSync} from 'node:fs';
import {fileURLToPath} from 'node:url';
import {parseArgs} from 'node:util';
import {isMainThread, parentPort, Worker, workerData} from 'node:worker_threads';

import {NAME, readAccessor} from '../src/accessors.js';
import {decodeWith} from '../src/engine.js';
import {expand} from '../src/expand.js';
import {TexfError} from '../src/index.js';
import {altered, Chance, treeOf} from './mutations.mjs';

const SLOW_SECONDS = 2, HANG_SECONDS = 60, MOST_MEMORY = 256 * 1024, FAILED = 7; // seconds of the processor, and of the clock; kB that an input adds
const LIMITS = {voxels: 1 << 18, texels: 1 << 18, vertices: 1 << 16, faces: 1 << 16};
const CODES = ['invalid', 'unsupported', 'limit', 'memory'];

/** Good files of conformance/container/, in the order of their names. */
function seeds() {
  const folder = new URL('../../conformance/container/', import.meta.url);
  return readdirSync(folder).filter((name) => !name.startsWith('faulty_')).sort().map((name) => new Uint8Array(readFileSync(new URL(`${name}/in.glb`, folder))));
}

/** Input n of a seed. @param {Uint8Array[]} files @param {number} seed @param {number} n */
export function inputOf(files, seed, n) {
  const chance = new Chance(seed, n);
  return altered(chance.pick(files), chance.pick(files), chance);
}

/** A decoder that decodes equal streams once. */
function decoderOf() {
  const module = new WebAssembly.Module(readFileSync(new URL('../src/texf_simd.wasm', import.meta.url))), known = new Map();
  const decode = async (stream, {limits}) => {
    const key = Buffer.from(stream).toString('latin1');
    if (!known.has(key) && known.size > 256) known.clear();
    if (!known.has(key)) known.set(key, decodeWith(module, stream, 0, limits));
    return known.get(key);
  };
  return {decode};
}

/** Throws an Error unless coded meshes of an expanded file can be read. @param {ArrayBuffer} file @param {any} source tree before */
async function check(file, source) {
  const {root, binary} = treeOf(new Uint8Array(file)), view = async (number) => {
    const {byteOffset = 0, byteLength} = root.bufferViews[number];
    return binary.subarray(byteOffset, byteOffset + byteLength);
  };
  const coded = (primitive) => primitive.extensions?.[NAME];
  if (root.extensions?.[NAME] || root.extensionsUsed?.includes(NAME)) throw new Error('the extension is left');
  for (const [n, {primitives}] of (source.meshes ?? []).entries()) {
    for (const {attributes, indices} of primitives?.length && primitives.every(coded) ? root.meshes[n].primitives : []) {
      for (const number of Object.values(attributes)) await readAccessor(root, number, view);
      const {count} = root.accessors[attributes.POSITION], used = await readAccessor(root, indices, view);
      if (used.some((vertex) => vertex >= count)) throw new Error('an index beyond the vertices');
    }
  }
}

/** What becomes of an input: "value" or a code; anything else is thrown. @param {Uint8Array} input @param {{decode: any}} decoder */
async function outcomeOf(input, decoder) {
  const {buffer: file} = input.slice();
  try {
    const result = await expand(file, {decoder, limits: LIMITS});
    if (result !== file) await check(result, treeOf(input).root);
  } catch (error) {
    const {code, message, details} = error;
    if (!(error instanceof TexfError) || !CODES.includes(code) || message.length < 10 || (code === 'invalid' && !/^TXF-/.test(details.finding))) throw error;
    return details.finding ?? code;
  }
  if (!Buffer.from(file).equals(input)) throw new Error('the input is changed');
  return 'value';
}

/** The executions of a run, in a worker that the main thread watches. */
async function work({seed, first, last, panel}) {
  const files = seeds(), decoder = decoderOf(), outcomes = {}, findings = [], begin = process.cpuUsage();
  for (let n = first; n < last; n++) {
    const before = process.cpuUsage(), {maxRSS} = process.resourceUsage();
    const outcome = await outcomeOf(inputOf(files, seed, n), decoder).catch((error) => {
      findings.push({n, said: String(error.stack).slice(0, 600)});
      return 'finding';
    });
    const {user, system} = process.cpuUsage(before), more = process.resourceUsage().maxRSS - maxRSS;
    if (user + system > SLOW_SECONDS * 1e6) findings.push({n, said: `${(user + system) / 1e6} s of the processor`});
    if (more > MOST_MEMORY) findings.push({n, said: `${more} kB more than before`});
    outcomes[outcome] = (outcomes[outcome] ?? 0) + 1;
    Atomics.store(panel, 0, n + 1);
    if (findings.length >= 20) last = n + 1;
  }
  const {user, system} = process.cpuUsage(begin);
  parentPort.postMessage({executions: last - first, seconds: Math.round((user + system) / 1e5) / 10, outcomes, findings});
}

/** Runs a worker to its end; an input that does not end is a finding. @param {any} request @returns {Promise<any>} */
function supervised(request) {
  const panel = new Int32Array(new SharedArrayBuffer(4)), worker = new Worker(fileURLToPath(import.meta.url), {workerData: {...request, panel}});
  return new Promise((resolve, reject) => {
    let n = -1;
    const watch = setInterval(() => {
      if (panel[0] === n) end({executions: n - request.first, outcomes: {}, findings: [{n: Math.max(n, request.first), said: `no end in ${HANG_SECONDS} s`}]});
      n = panel[0];
    }, HANG_SECONDS * 1000);
    const end = (answer) => {
      clearInterval(watch);
      worker.terminate().then(() => resolve(answer));
    };
    worker.on('message', end);
    worker.on('error', reject);
  });
}

if (!isMainThread) await work(workerData);
else {
  const options = {executions: {type: 'string', default: '1000'}, seed: {type: 'string', default: '1'}, first: {type: 'string', default: '0'}, save: {type: 'string'}};
  const {executions, seed, first, save} = parseArgs({options}).values, request = {seed: Number(seed), first: Number(first), last: Number(first) + Number(executions)};
  const answer = await supervised(request), files = seeds();
  if (save) for (const {n} of answer.findings) writeFileSync(`${save}/container-${seed}-${n}.glb`, inputOf(files, request.seed, n));
  console.log(JSON.stringify(answer, null, 1));
  process.exitCode = answer.findings.length ? FAILED : 0;
}
