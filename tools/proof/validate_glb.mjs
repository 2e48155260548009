// Validate GLB or glTF files with Khronos's own validator: node tools/proof/validate_glb.mjs FILE...
// Prints errors and warnings per file; exits 1 if any file has errors, 2 if a file or the validator cannot be read.
// Needs the package gltf-validator where node finds it from the current directory, from here or from js/ (npm install in js/).

import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import path from 'node:path';

function loadValidator() {
  for (const base of [path.join(process.cwd(), 'x.js'), import.meta.url, new URL('../../js/x.js', import.meta.url)]) {
    try {
      return createRequire(base)('gltf-validator');
    } catch (error) {
      if (error.code !== 'MODULE_NOT_FOUND') throw error;
    }
  }
  console.error('gltf-validator is not installed: npm install in js/');
  process.exit(2);
}

async function validate(validator, file) {
  const folder = path.dirname(file);
  const report = await validator.validateBytes(new Uint8Array(await readFile(file)), {
    uri: path.basename(file),
    externalResourceFunction: async (uri) => new Uint8Array(await readFile(path.join(folder, decodeURIComponent(uri)))),
  });
  const { numErrors, numWarnings, numInfos, messages } = report.issues;
  console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} notes`);
  for (const m of messages.filter((m) => m.severity < 2).slice(0, 20)) {
    console.log(`  ${m.severity === 0 ? 'error' : 'warning'} ${m.code} ${m.pointer ?? ''} ${m.message}`);
  }
  return numErrors;
}

const validator = loadValidator();
const files = process.argv.slice(2);
if (files.length === 0) {
  console.error('usage: node tools/proof/validate_glb.mjs FILE...');
  process.exit(2);
}
let errors = 0;
for (const file of files) {
  try {
    errors += await validate(validator, file);
  } catch (error) {
    console.error(`${file}: ${error.message ?? error}`);
    process.exit(2);
  }
}
process.exit(errors > 0 ? 1 : 0);
