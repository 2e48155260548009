// Every vector through the npm package in Chromium, under the narrowest content security policy, and how long streams take there.
//
//   node tools/proof/chromium/vectors.mjs [--times FILE.texf ...] [CASE ...]     CASE as of conformance/run.py, which compares
//
// Call it in a folder that has three and playwright-core, such as js/ after npm install; $PYTHON is python3 where nothing is said.
// Whatever the page writes to its console is a failure. Ends with 0 or 7.

import { spawn } from 'node:child_process';
import { copyFile, cp, mkdtemp, rm } from 'node:fs/promises';
import http from 'node:http';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

import { withPage } from '../three_page.mjs';

export const POLICY = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; connect-src 'self'";
const PAGE = '<!doctype html><meta charset="utf-8"><title>vectors</title><script type="module" src="/cache/proof/page.mjs"></script>';
const here = path.dirname(fileURLToPath(import.meta.url)), repository = path.resolve(here, '../../..');
const given = process.argv.slice(2), times = given[0] === '--times' ? given.filter((name) => name.endsWith('.texf')) : [];
const cases = given.filter((name) => !name.startsWith('--') && !times.includes(name));

// Answers ask.mjs: the page decodes, one stream at a time.
async function served(page, root, work) {
  let turn = Promise.resolve();
  const server = http.createServer(async (request, response) => {
    const { stream, level } = JSON.parse(await new Response(request).text());
    turn = turn.then(async () => {
      await copyFile(stream, path.join(root, 'in.texf'));
      const answer = await page.evaluate(([url, l]) => window.answer(url, l), ['/cache/in.texf', level]);
      response.end(JSON.stringify(answer));
    });
  });
  await new Promise((ready) => server.listen(0, '127.0.0.1', ready));
  try {
    return await work(`http://127.0.0.1:${server.address().port}/`);
  } finally {
    server.close();
  }
}

function compared(address) {
  const decoder = `${process.execPath} ${path.join(here, 'ask.mjs')}`, call = [path.join(repository, 'conformance', 'run.py'), '--decoder', decoder, ...cases];
  const run = spawn(process.env.PYTHON ?? 'python3', call, { env: { ...process.env, TEXF_ASK: address }, stdio: ['ignore', 'pipe', 'inherit'] });
  let text = '';
  run.stdout.on('data', (part) => { text += part; });
  return new Promise((resolve) => run.on('close', (code) => {
    const lines = text.trim().split('\n');
    for (const line of lines.filter((one) => one.startsWith('FAIL'))) console.log(line);
    resolve({ code, summary: lines.at(-1) });
  }));
}

const root = await mkdtemp(path.join(os.tmpdir(), 'texf-chromium-')), messages = [];
let code = 0;
try {
  for (const name of ['src', 'test']) await cp(path.join(repository, 'js', name), path.join(root, 'js', name), { recursive: true });
  await cp(path.join(here, 'page.mjs'), path.join(root, 'proof', 'page.mjs'));
  await withPage(PAGE, root, async (browser, address) => {
    const page = await browser.newPage();
    page.on('console', (message) => messages.push(`${message.type()}: ${message.text()}`));
    page.on('pageerror', (error) => messages.push(String(error)));
    await page.goto(address, { waitUntil: 'load' });
    for (const name of times) {
      await copyFile(name, path.join(root, 'in.texf'));
      console.log(JSON.stringify({ name: path.basename(name), ...await page.evaluate(() => window.timed('/cache/in.texf', 5)) }));
    }
    const begin = performance.now(), told = await served(page, root, compared);
    code = told.code;
    console.log(`${told.summary}, Chromium ${browser.version()}, ${Math.round((performance.now() - begin) / 1000)} s, ${messages.length} console messages`);
  }, { headers: { 'content-security-policy': POLICY } });
} finally {
  await rm(root, { recursive: true });
}
for (const message of messages) console.log(message);
process.exitCode = code || (messages.length ? 7 : 0);
