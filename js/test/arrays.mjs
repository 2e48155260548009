/** The arrays of clause 9 as conformance/run.py compares them, in node and in browsers. */

/** Exit codes of a TexfError's codes. */
export const EXIT = {invalid: 3, internal: 4, unsupported: 5, limit: 6, memory: 6, aborted: 130};

/**
 * @param {any} said the description of a stream
 * @param {(kind: any, i?: number, j?: number) => ArrayBuffer} array as Engine.array
 * @returns {Object<string, Uint8Array>} contents by name
 */
export function arraysOf(said, array) {
  const units = said.units.map((unit, i) => ({...unit, positions: new Uint32Array(array('positions', i)),
    faces: new Uint32Array(array('faces', i)), uvs: new Int32Array(array('uvs', i))}));
  const files = {geometry: rowsOf(units)};
  if (said.sharp_edges) files.sharp_edges = array('sharpEdges');
  if (said.coded_normals) files.coded_normals = array('codedNormals');
  said.fields.forEach((field, i) => {
    files[`field${i}_keys`] = array('keys', i);
    if (field.planar) files[`field${i}_uv`] = rowsOf(units, i);
    said.groups.forEach((_, g) => {
      const values = array('values', i, g);
      if (values.byteLength) files[`field${i}_group${g}_values`] = values;
    });
  });
  return Object.fromEntries(Object.entries(files).map(([name, content]) => [name, new Uint8Array(content.buffer ?? content)]));
}

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
