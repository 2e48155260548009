/** node expand_file.mjs IN.glb OUT.glb ...: expand() of files, as conformance/run_containers.py asks of any expander. */

import {readFileSync, writeFileSync} from 'node:fs';

import {expand} from '../src/gltf.js';
import {dispose, TexfError} from '../src/index.js';
import {EXIT} from './arrays.mjs';

const INPUT = 2; // exit code of glTF files that are invalid
try {
  for (let i = 2; i < process.argv.length; i += 2) {
    const {buffer, byteOffset, length} = readFileSync(process.argv[i]);
    writeFileSync(process.argv[i + 1], new Uint8Array(await expand(buffer.slice(byteOffset, byteOffset + length))));
  }
} catch (error) {
  if (!(error instanceof TexfError)) throw error;
  const {finding = ''} = error.details;
  console.error(finding ? `${finding}: ${error.message}` : error.message);
  process.exitCode = error.code === 'invalid' && finding.startsWith('TXF-I') ? INPUT : EXIT[error.code];
}
dispose();
