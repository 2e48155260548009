// Makes ../web/viewer.js, or the file that is named, of the modules here, js/src and three.js, after npm install in js/:
// node texfcodec/viewer/app/bundle.mjs [FILE]
// The same sources give the same bytes. Its first lines hold three.js's licence and a digest of all that it is made of.

import {createHash} from 'node:crypto';
import {readFileSync, readdirSync, writeFileSync} from 'node:fs';
import {createRequire} from 'node:module';
import path from 'node:path';
import {fileURLToPath} from 'node:url';

const app = path.dirname(fileURLToPath(import.meta.url)), js = path.join(app, '../../../js'), require = createRequire(path.join(js, 'package.json'));
const esbuild = require('esbuild'), licence = readFileSync(path.join(js, 'node_modules/three/LICENSE'), 'utf8').trim();
const options = {
  bundle: true, minify: true, write: false, format: 'iife', target: 'es2022', charset: 'ascii', legalComments: 'none', logLevel: 'error',
  nodePaths: [path.join(js, 'node_modules')], external: ['node:*'], define: {'import.meta.url': '"null:"'},
};
const built = async (more) => (await esbuild.build({...options, ...more})).outputFiles[0].text;

/** SHA-256 of the sources and of package.json's versions, as tests/viewer/test_view_bundle.py takes it. */
function digest() {
  const sum = createHash('sha256'), {devDependencies: {three, esbuild: bundler}} = JSON.parse(readFileSync(path.join(js, 'package.json'), 'utf8'));
  sum.update(`three ${three} esbuild ${bundler}\n`);
  for (const folder of [app, path.join(js, 'src')]) {
    for (const name of readdirSync(folder).filter((file) => /\.m?js$/.test(file)).sort()) sum.update(`${name}\n`).update(readFileSync(path.join(folder, name)));
  }
  return sum.digest('hex');
}

const worker = await built({entryPoints: [path.join(js, 'src/worker.js')]});
const texf = {
  name: 'texf',
  setup(build) {
    build.onResolve({filter: /^texf\//}, ({path: name}) => name === 'texf/worker-text' ? {path: name, namespace: 'text'} : {path: path.join(js, 'src', `${name.slice(5)}.js`)});
    build.onLoad({filter: /.*/, namespace: 'text'}, () => ({contents: worker, loader: 'text'}));
  },
};
const viewer = await built({entryPoints: [path.join(app, 'main.js')], plugins: [texf]});
writeFileSync(process.argv[2] ?? path.join(app, '../web/viewer.js'), `/* texf-view, made by app/bundle.mjs with three.js (below its licence)
sources ${digest()}

three.js
${licence} */
${viewer}`);
