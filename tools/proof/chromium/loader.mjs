// TEXFLoader in Chromium on bad downloads, aborts, disposals, a lost context and many loads: a line each, ends with 0 or 7.
//
//   node tools/proof/chromium/loader.mjs [--pictures FOLDER] [FILE.texf ...]
//
// Call it in a folder that has three and playwright-core, such as js/ after npm install. The last two checks take the files that are
// given, or two of the vectors.

import { createHash } from 'node:crypto';
import { copyFile, cp, mkdir, mkdtemp, readFile, rm } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

import { withPage } from '../three_page.mjs';

const MAP = '{"imports": {"three": "/three/build/three.module.js"}}';
const POLICY = `default-src 'none'; script-src 'self' 'wasm-unsafe-eval' 'sha256-${createHash('sha256').update(MAP).digest('base64')}'; worker-src 'self'; connect-src 'self'`;
const PAGE = `<!doctype html><meta charset="utf-8"><title>loader</title><script type="importmap">${MAP}</script>
<body><script type="module" src="/cache/proof/loader_page.mjs"></script>`;
const EXPECTED = /Failed to load resource|Context (Lost|Restored)|belong to this context|GPU stall/; // the browser's word on what is done to it here

const here = path.dirname(fileURLToPath(import.meta.url)), repository = path.resolve(here, '../../..'), given = process.argv.slice(2);
const pictures = given[0] === '--pictures' ? given.splice(0, 2)[1] : null;
const vectors = ['subset/texels', 'subset/k33'].map((name) => path.join(repository, 'conformance', name, 'in.texf'));
const streams = given.length ? given : vectors, good = await readFile(vectors[0]);

let closed = 0; // downloads that the page gave up
const sends = (body, type = 'application/octet-stream', status = 200) => (_, response) => response.writeHead(status, { 'content-type': type }).end(body);
const routes = {
  '/good.texf': sends(good),
  '/text.texf': sends(good, 'text/plain'),
  '/other.texf': sends(good),
  '/cut.texf': sends(good.subarray(0, good.length >> 1)),
  '/broken.texf': (_, response) => {
    response.writeHead(200, { 'content-length': good.length }).write(good.subarray(0, good.length >> 1));
    setTimeout(() => response.destroy(), 50);
  },
  '/page.texf': sends('<!doctype html><title>not found</title>', 'text/html'),
  '/empty.texf': sends(''),
  '/nowhere.texf': sends('no', 'text/plain', 404),
  '/slow.texf': (request, response) => {
    response.writeHead(200, { 'content-length': good.length }).write(good.subarray(0, 100));
    response.on('close', () => { closed++; });
  },
};

let failed = 0;
function told(name, passes, found) {
  failed += !passes;
  console.log(`${passes ? 'ok  ' : 'FAIL'} ${name} ${JSON.stringify(found)}`);
}
const refused = (code) => ({ code: found, message, left }) => found === code && left === 0 && message.length > 10 && !message.includes('\n');

const root = await mkdtemp(path.join(os.tmpdir(), 'texf-loader-'));
try {
  await cp(path.join(repository, 'js', 'src'), path.join(root, 'js', 'src'), { recursive: true });
  await cp(path.join(here, 'loader_page.mjs'), path.join(root, 'proof', 'loader_page.mjs'));
  for (const [n, name] of streams.entries()) await copyFile(name, path.join(root, `${n}.texf`));
  if (pictures) await mkdir(pictures, { recursive: true });
  await withPage(PAGE, root, async (browser, address) => {
    const page = await browser.newPage({ viewport: { width: 420, height: 420 } }), messages = [];
    page.on('console', (message) => EXPECTED.test(message.text()) || messages.push(message.text()));
    page.on('pageerror', (error) => messages.push(String(error)));
    await page.goto(address, { waitUntil: 'load' });
    const asked = (name, ...parts) => page.evaluate(([n, p]) => window.check[n](...p), [name, parts]);
    const once = async (title, code, ...call) => {
      const found = await asked(...call);
      told(title, code ? refused(code)(found) : found.meshes === 1 && found.left === 0, found);
    };
    await once('a stream', null, 'outcome', '/good.texf');
    await once('a stream that is called text', null, 'outcome', '/text.texf');
    await once('a file that was cut', 'invalid', 'outcome', '/cut.texf');
    await once('a connection that breaks', 'network', 'outcome', '/broken.texf');
    await once('an HTML page', 'invalid', 'outcome', '/page.texf');
    await once('an empty file', 'invalid', 'outcome', '/empty.texf');
    await once('a file that is not there', 'network', 'outcome', '/nowhere.texf');
    await once('a limit', 'limit', 'limited', '/good.texf');
    await once('abort of a download', 'aborted', 'aborted', '/slow.texf', 100);
    await once('disposal in a download', 'aborted', 'disposed', '/slow.texf', 100);
    told('both downloads were given up', closed === 2, { closed });
    for (const [n, ms] of [[0, 0], [0, 10]]) {
      const found = await asked('aborted', `/cache/${n}.texf`, ms);
      told(`abort after ${ms} ms`, found.left === 0 && (found.code === 'aborted' || found.meshes > 0), found);
    }
    const three = await asked('atOnce', '/good.texf', '/other.texf');
    told('three loaders at once', three.every((one) => one.meshes === 1 && one.left === 0), three);
    const shared = await asked('shared', '/good.texf');
    told('two loads of one loader, an abort, and one more', shared.code === 'aborted' && shared.again === 1 && shared.meshes.join() === '1,1', shared);
    const session = await page.context().newCDPSession(page);
    const heap = async () => {
      await session.send('HeapProfiler.collectGarbage');
      return (await session.send('Runtime.getHeapUsage')).usedSize / 1048576;
    };
    for (const [n, name] of streams.entries()) {
      const found = await asked('restored', `/cache/${n}.texf`), title = path.basename(name, '.texf');
      if (pictures) await page.locator('canvas').screenshot({ path: path.join(pictures, `${title}-${n}-restored.png`) });
      told(`a lost context comes back, ${title}`, found.differ === 0 && found.covered > 1000, found);
      await asked('clear');
      await asked('loads', `/cache/${n}.texf`, 5);
      const before = await heap(), first = await asked('loads', `/cache/${n}.texf`, 1), last = await asked('loads', `/cache/${n}.texf`, 50);
      const grown = await heap() - before, workers = page.workers().length;
      const same = JSON.stringify(first) === JSON.stringify(last);
      told(`50 loads and disposals, ${title}`, same && workers === 0 && last.geometries === 0 && grown < 2, { ...last, workers, grown_MB: grown.toFixed(2), heap_MB: before.toFixed(1) });
    }
    told('nothing else was said', messages.length === 0, messages);
  }, { headers: { 'content-security-policy': POLICY }, routes });
} finally {
  await rm(root, { recursive: true });
}
process.exitCode = failed ? 7 : 0;
