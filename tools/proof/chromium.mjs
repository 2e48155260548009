// The npm package in Chromium: vectors through its workers under the narrowest content security policy, and TEXFLoader on bad downloads,
// aborts, disposals, a lost context and many loads.
//
//   node tools/proof/chromium.mjs vectors [--times FILE.texf ...] [CASE ...]     CASE as of conformance/run.py, which compares
//   node tools/proof/chromium.mjs loader [--loads 50] [--pictures FOLDER] [FILE.texf ...]     a line a check; the last two take the files, or two vectors
//
// Call it in a folder that has three and playwright-core, such as js/ after npm install; $PYTHON is python3 where nothing is said. What
// the page writes to its console is a failure. Ends with 0 or 7. With $TEXF_ASK it is the decoder's command that conformance/run.py calls.

import { spawn } from 'node:child_process';
import { createHash } from 'node:crypto';
import { mkdirSync, writeFileSync } from 'node:fs';
import { copyFile, cp, mkdir, mkdtemp, readFile, rm } from 'node:fs/promises';
import http from 'node:http';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

import { withPage } from './three_page.mjs';

const MAP = '{"imports": {"three": "/three/build/three.module.js"}}';
const DIGEST = `'sha256-${createHash('sha256').update(MAP).digest('base64')}'`;
const policy = (digest) => `default-src 'none'; script-src 'self' 'wasm-unsafe-eval'${digest}; worker-src 'self'; connect-src 'self'`;
const page = (map, query) => `<!doctype html><meta charset="utf-8"><title>texf</title>${map}<body><script type="module" src="/cache/proof/chromium_page.mjs?${query}"></script>`;
const EXPECTED = /Failed to load resource|Context (Lost|Restored)|belong to this context|GPU stall/; // the browser's word on what is done to it here

const here = path.dirname(fileURLToPath(import.meta.url)), repository = path.dirname(path.dirname(here)), [mode, ...given] = process.argv.slice(2);
const vector = (name) => path.join(repository, 'conformance', name, 'in.texf');
let failed = 0;
function report(name, passes, found) {
  failed += !passes;
  console.log(`${passes ? 'ok  ' : 'FAIL'} ${name} ${JSON.stringify(found)}`);
}

// A decoder's command: hands the stream to the browser, at the address in $TEXF_ASK.
async function ask(stream, folder, option, level) {
  const body = JSON.stringify({ stream: path.resolve(stream), level: option === '--lod' ? Number(level) : 0 });
  const { code, files, message } = await (await fetch(process.env.TEXF_ASK, { method: 'POST', body })).json();
  mkdirSync(folder, { recursive: true });
  for (const [name, content] of Object.entries(files)) writeFileSync(path.join(folder, `${name}.bin`), Buffer.from(content, 'base64'));
  if (message) console.error(message);
  process.exitCode = code;
}

// Opens the page in Chromium and calls work(page, root); messages of its console that `expected` does not match fail.
async function inChromium(html, options, expected, work) {
  const root = await mkdtemp(path.join(os.tmpdir(), 'texf-chromium-')), messages = [];
  try {
    for (const name of ['src', 'test']) await cp(path.join(repository, 'js', name), path.join(root, 'js', name), { recursive: true });
    await cp(path.join(here, 'chromium_page.mjs'), path.join(root, 'proof', 'chromium_page.mjs'));
    await withPage(html, root, async (browser, address) => {
      const opened = await browser.newPage({ viewport: { width: 420, height: 420 } });
      opened.on('console', (message) => expected?.test(message.text()) || messages.push(message.text()));
      opened.on('pageerror', (error) => messages.push(String(error)));
      await opened.goto(address, { waitUntil: 'load' });
      await opened.waitForFunction(() => window.check);
      await work(opened, root, browser);
      report('nothing else was said', messages.length === 0, messages);
    }, options);
  } finally {
    await rm(root, { recursive: true });
  }
}

// Every vector

async function served(opened, root, work) { // answers ask(): the page decodes, one stream at a time
  let turn = Promise.resolve();
  const server = http.createServer(async (request, response) => {
    const { stream, level } = JSON.parse(await new Response(request).text());
    turn = turn.then(async () => {
      await copyFile(stream, path.join(root, 'in.texf'));
      response.end(JSON.stringify(await opened.evaluate(([url, l]) => window.check.answer(url, l), ['/cache/in.texf', level])));
    });
  });
  await new Promise((ready) => server.listen(0, '127.0.0.1', ready));
  try {
    return await work(`http://127.0.0.1:${server.address().port}/`);
  } finally {
    server.close();
  }
}

async function vectors() {
  const times = given[0] === '--times' ? given.filter((name) => name.endsWith('.texf')) : [];
  const cases = given.filter((name) => !name.startsWith('--') && !times.includes(name));
  await inChromium(page('', ''), { headers: { 'content-security-policy': policy('') } }, null, async (opened, root, browser) => {
    for (const name of times) {
      await copyFile(name, path.join(root, 'in.texf'));
      console.log(JSON.stringify({ name: path.basename(name), ...await opened.evaluate(() => window.check.timed('/cache/in.texf', 5)) }));
    }
    const call = [path.join(repository, 'conformance', 'run.py'), '--decoder', `${process.execPath} ${fileURLToPath(import.meta.url)}`, ...cases];
    await served(opened, root, (address) => new Promise((resolve) => {
      const run = spawn(process.env.PYTHON ?? 'python3', call, { env: { ...process.env, TEXF_ASK: address }, stdio: ['ignore', 'pipe', 'inherit'] });
      let text = '';
      run.stdout.on('data', (part) => { text += part; });
      run.on('close', (code) => {
        for (const line of text.split('\n').filter((row) => row.startsWith('FAIL'))) console.log(line);
        report(`vectors in Chromium ${browser.version()}`, code === 0, text.trim().split('\n').at(-1));
        resolve();
      });
    }));
  });
}

// Bad downloads

const refused = (code) => ({ code: actual, message, left }) => actual === code && left === 0 && message.length > 10 && !message.includes('\n');
const loaded = ({ meshes, left }) => meshes === 1 && left === 0;
const ONCE = [ // what it is, the code that it is refused with, the check of the page and its arguments
  ['a stream', null, 'outcome', '/good.texf'], ['a stream that is called text', null, 'outcome', '/text.texf'],
  ['a file that was cut', 'invalid', 'outcome', '/cut.texf'], ['a connection that breaks', 'network', 'outcome', '/broken.texf'],
  ['an HTML page', 'invalid', 'outcome', '/page.texf'], ['an empty file', 'invalid', 'outcome', '/empty.texf'],
  ['a file that is not there', 'network', 'outcome', '/nowhere.texf'], ['a limit', 'limit', 'limited', '/good.texf'],
  ['abort of a download', 'aborted', 'aborted', '/slow.texf', 100], ['disposal in a download', 'aborted', 'disposed', '/slow.texf', 100],
];

async function loader() {
  const loads = given[0] === '--loads' ? Number(given.splice(0, 2)[1]) : 50;
  const pictures = given[0] === '--pictures' ? given.splice(0, 2)[1] : null;
  const streams = given.length ? given : [vector('subset/texels'), vector('subset/k33')], good = await readFile(vector('subset/texels'));
  let closed = 0; // downloads that the page gave up
  const sends = (body, type = 'application/octet-stream', status = 200) => (_, response) => response.writeHead(status, { 'content-type': type }).end(body);
  const half = (end) => (_, response) => {
    response.writeHead(200, { 'content-length': good.length }).write(good.subarray(0, good.length >> 1));
    end(response);
  };
  const routes = {
    '/good.texf': sends(good), '/other.texf': sends(good), '/text.texf': sends(good, 'text/plain'), '/cut.texf': sends(good.subarray(0, good.length >> 1)),
    '/page.texf': sends('<!doctype html><title>not found</title>', 'text/html'), '/empty.texf': sends(''), '/nowhere.texf': sends('no', 'text/plain', 404),
    '/broken.texf': half((response) => setTimeout(() => response.destroy(), 50)), '/slow.texf': half((response) => response.on('close', () => { closed++; })),
  };
  const html = page(`<script type="importmap">${MAP}</script>`, 'loader'), headers = { 'content-security-policy': policy(` ${DIGEST}`) };
  await inChromium(html, { headers, routes }, EXPECTED, async (opened, root) => {
    const check = (name, ...parts) => opened.evaluate(([n, p]) => window.check[n](...p), [name, parts]);
    for (const [n, name] of streams.entries()) await copyFile(name, path.join(root, `${n}.texf`));
    for (const [title, code, ...call] of ONCE) {
      const outcome = await check(...call);
      report(title, (code ? refused(code) : loaded)(outcome), outcome);
    }
    report('both downloads were given up', closed === 2, { closed });
    for (const ms of [0, 10]) {
      const outcome = await check('aborted', '/cache/0.texf', ms);
      report(`abort after ${ms} ms`, outcome.left === 0 && (outcome.code === 'aborted' || outcome.meshes > 0), outcome);
    }
    const three = await check('atOnce', '/good.texf', '/other.texf'), shared = await check('shared', '/good.texf');
    report('three loaders at once', three.every(loaded), three);
    report('two loads of one loader, an abort, and one more', shared.code === 'aborted' && shared.again === 1 && shared.meshes.join() === '1,1', shared);
    const session = await opened.context().newCDPSession(opened);
    const heap = async () => {
      await session.send('HeapProfiler.collectGarbage');
      return (await session.send('Runtime.getHeapUsage')).usedSize / 1048576;
    };
    for (const [n, name] of streams.entries()) {
      const outcome = await check('restored', `/cache/${n}.texf`), title = path.basename(name, '.texf');
      if (pictures) {
        await mkdir(pictures, { recursive: true });
        await opened.locator('canvas').screenshot({ path: path.join(pictures, `${title}-${n}-restored.png`) });
      }
      report(`a lost context comes back, ${title}`, outcome.differ === 0 && outcome.covered > 1000, outcome);
      await check('clear');
      await check('loads', `/cache/${n}.texf`, 5);
      const before = await heap(), first = await check('loads', `/cache/${n}.texf`, 1), last = await check('loads', `/cache/${n}.texf`, loads);
      const grown = await heap() - before, workers = opened.workers().length, same = JSON.stringify(first) === JSON.stringify(last);
      report(`${loads} loads and disposals, ${title}`, same && workers === 0 && last.geometries === 0 && grown < 2, { ...last, workers, grown_MB: grown.toFixed(2), heap_MB: before.toFixed(1) });
    }
  });
}

if (process.env.TEXF_ASK) {
  await ask(mode, ...given);
} else {
  await { vectors, loader }[mode]();
  process.exitCode = failed ? 7 : 0;
}
