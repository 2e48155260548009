/** node expand_file.mjs IN.glb OUT.glb ...: expand() of files. */

import {readFileSync, writeFileSync} from 'node:fs';

import {expand} from '../src/gltf.js';
import {dispose} from '../src/index.js';

for (let i = 2; i < process.argv.length; i += 2) {
  const {buffer, byteOffset, length} = readFileSync(process.argv[i]);
  writeFileSync(process.argv[i + 1], new Uint8Array(await expand(buffer.slice(byteOffset, byteOffset + length))));
}
dispose();
