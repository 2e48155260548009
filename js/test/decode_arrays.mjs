/** The decoder in node as conformance/run.py asks of any: node js/test/decode_arrays.mjs IN.texf OUT_DIR [--lod L] */

import {mkdirSync, readFileSync, writeFileSync} from 'node:fs';

import {Engine, TexfError} from '../src/engine.js';

const EXIT = {invalid: 3, internal: 4, unsupported: 5, limit: 6, memory: 6, aborted: 130};

/** Clause 9: rows of triangles, each begun so that it is least, sorted. */
function rowsOf(units, only) {
  const rows = [];
  for (const unit of units) {
    if (only !== undefined && unit.field !== only) continue;
    for (let f = 0; f < unit.faces.length; f += 3) {
      const corners = [0, 1, 2].map((i) => {
        const v = unit.faces[f + i], at = [...unit.positions.subarray(3 * v, 3 * v + 3)];
        return only === undefined ? at : [...at, ...unit.uvs.subarray(2 * v, 2 * v + 2)];
      });
      const turns = [0, 1, 2].map((t) => [...corners[t], ...corners[(t + 1) % 3], ...corners[(t + 2) % 3]]).sort(compare);
      rows.push([unit.field, unit.material, ...turns[0]]);
    }
  }
  return BigInt64Array.from(rows.sort(compare).flat(), BigInt);
}

function compare(a, b) {
  const i = a.findIndex((v, n) => v !== b[n]);
  return i < 0 ? 0 : a[i] - b[i];
}

const [stream, folder, ...rest] = process.argv.slice(2);
const module = new WebAssembly.Module(readFileSync(new URL('../src/texf.wasm', import.meta.url)));
try {
  const engine = new Engine(module);
  engine.decode(readFileSync(stream), rest[0] === '--lod' ? Number(rest[1]) : 0);
  const said = JSON.parse(new TextDecoder().decode(engine.array('description')));
  const units = said.units.map((unit, i) => ({...unit, positions: new Uint32Array(engine.array('positions', i)),
    faces: new Uint32Array(engine.array('faces', i)), uvs: new Int32Array(engine.array('uvs', i))}));
  const files = {geometry: rowsOf(units)};
  if (said.sharp_edges) files.sharp_edges = engine.array('sharpEdges');
  if (said.coded_normals) files.coded_normals = engine.array('codedNormals');
  said.fields.forEach((field, i) => {
    files[`field${i}_keys`] = engine.array('keys', i);
    if (field.planar) files[`field${i}_uv`] = rowsOf(units, i);
    said.groups.forEach((_, g) => {
      const values = engine.array('values', i, g);
      if (values.byteLength) files[`field${i}_group${g}_values`] = values;
    });
  });
  mkdirSync(folder, {recursive: true});
  for (const [name, content] of Object.entries(files)) writeFileSync(`${folder}/${name}.bin`, new Uint8Array(content.buffer ?? content));
} catch (error) {
  if (!(error instanceof TexfError)) throw error;
  console.error(error.message);
  process.exitCode = EXIT[error.code];
}
