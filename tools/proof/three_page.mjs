// A page with three.js in a browser without a window, for tools that draw with a renderer that is not ours. Node finds three and
// playwright-core from the folder it is called in; Chromium stands at $CHROMIUM or /usr/bin/chromium.

import { readFile } from 'node:fs/promises';
import http from 'node:http';
import { createRequire } from 'node:module';
import path from 'node:path';

const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.mjs': 'text/javascript', '.wasm': 'application/wasm' };
const FLAGS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'];

// What a page's modules say "three" and "three/addons/" for.
export const IMPORTS = `<script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>`;

// Serves html at /, three.js at /three/ and the files of `root` at /cache/, all with `headers`, and what `routes` answer: {path:
// (request, response) => ...}; elsewhere(file, root): bytes of a file that is not there, or null. Calls work(browser, address) and
// ends both.
export async function withPage(html, root, work, { headers = {}, routes = {}, elsewhere = () => null } = {}) {
  const require = createRequire(path.join(process.cwd(), 'x.js')), three = path.dirname(path.dirname(require.resolve('three')));
  const server = http.createServer(async (request, response) => {
    const name = path.posix.normalize(decodeURIComponent(new URL(request.url, 'http://x').pathname)), [, top] = name.split('/');
    if (name in routes) return routes[name](request, response);
    const file = path.join(top === 'cache' ? root : three, name.slice(top.length + 1));
    const body = name === '/' ? html : name === '/favicon.ico' ? '' : await readFile(file).catch(() => elsewhere(file, root));
    const type = name === '/' ? 'text/html' : TYPES[path.extname(name)] ?? 'application/octet-stream';
    return response.writeHead(body === null ? 404 : 200, { ...headers, 'content-type': type }).end(body ?? '');
  });
  await new Promise((ready) => server.listen(0, '127.0.0.1', ready));
  const executablePath = process.env.CHROMIUM ?? '/usr/bin/chromium';
  const browser = await require('playwright-core').chromium.launch({ executablePath, args: FLAGS });
  try {
    await work(browser, `http://127.0.0.1:${server.address().port}/`);
  } finally {
    await browser.close();
    server.close();
  }
}
