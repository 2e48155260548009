/** The decoder in node as conformance/run.py asks of any: node js/test/decode_arrays.mjs IN.texf OUT_DIR [--lod L]; with vectors, or by the module $TEXF_WASM */

import {mkdirSync, readFileSync, writeFileSync} from 'node:fs';

import {Engine, TexfError} from '../src/engine.js';
import {EXIT, arraysOf} from './arrays.mjs';

const [stream, folder, ...rest] = process.argv.slice(2);
const module = new WebAssembly.Module(readFileSync(new URL(`../src/${process.env.TEXF_WASM ?? 'texf_simd.wasm'}`, import.meta.url)));
try {
  const engine = new Engine(module);
  engine.decode(readFileSync(stream), rest[0] === '--lod' ? Number(rest[1]) : 0);
  const said = JSON.parse(new TextDecoder().decode(engine.array('description')));
  const files = arraysOf(said, (...which) => engine.array(...which));
  mkdirSync(folder, {recursive: true});
  for (const [name, content] of Object.entries(files)) writeFileSync(`${folder}/${name}.bin`, content);
} catch (error) {
  if (!(error instanceof TexfError)) throw error;
  console.error(error.message);
  process.exitCode = EXIT[error.code];
}
