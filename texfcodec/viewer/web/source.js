// Where the page's data come from: its server, or the page itself where it was exported (viewer/page.py).

import { unpack } from './data.js';
import { isStream, StreamDecoder } from './decoding.js';
import { inlined, inlinedText, isExported } from './inlined.js';
import { withLight } from './stream_header.js';

const NO_STREAM = 'This page stands alone and reads .texf files; texf-view reads other meshes.';

export class Source {
  /** What the page knows of itself (server.about_page). */
  static async open() {
    const about = isExported() ? JSON.parse(inlinedText('about')) : await (await answerOf('about')).json();
    return new Source(about);
  }

  constructor(about) {
    const script = isExported() ? scriptOfPage() : { place: new URL('web/main.js', document.baseURI), type: 'module' };
    const wasm = () => this.bytes('decoder', 'web/texf.wasm');
    Object.assign(this, { about, streams: new StreamDecoder(script, wasm, about.limits), light: null });
  }

  /** ArrayBuffer of what the page holds under a name, or its server at a path. */
  async bytes(name, path) {
    return isExported() ? inlined(name) : (await answerOf(path)).arrayBuffer();
  }

  /** Headers of what the page was made for. */
  headers() {
    return Promise.all(this.about.names.map(async (name, n) => this.headerOf(await this.bytes(`asset-${n}`, `asset/${n}`), name)));
  }

  /** The header of a stream, or of a container (viewer/container.py). */
  async headerOf(buffer, name) {
    const header = isStream(new Uint8Array(buffer)) ? await this.streams.headerOf(buffer, name) : unpack(buffer);
    this.light ??= this.bytes('light', 'light').then(unpack);
    return withLight(header, await this.light);
  }

  /** The header of a file that somebody has dropped. Throws an Error whose message says what is wrong. */
  async headerOfFile(file) {
    const buffer = await file.arrayBuffer();
    try {
      if (isStream(new Uint8Array(buffer)) || isExported()) {
        if (!isStream(new Uint8Array(buffer))) throw new Error(NO_STREAM);
        return await this.headerOf(buffer, file.name);
      }
      if (!this.about.drop) throw new Error('This page takes no meshes.');
      return await this.headerOf(await read(file), file.name);
    } catch (error) {
      throw new Error(`${file.name} is not shown. ${sentence(error)}`, { cause: error });
    }
  }
}

/** The container of a mesh, which the server reads. */
async function read(file) {
  const answer = await fetch(`drop?name=${encodeURIComponent(file.name)}`, { method: 'POST', body: file }).catch(() => {
    throw new Error('The server does not answer: has texf-view ended?');
  });
  if (answer.ok) return answer.arrayBuffer();
  const text = await answer.text();
  const told = parsed(text);
  throw new Error(told ? `${told.code}: ${told.message}` : `${answer.status}: ${text.trim()}`);
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

async function answerOf(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path} answers ${answer.status}`);
  return answer;
}

/** The script of an exported page, which has no file of its own; a page from disk may have no worker of type module. */
function scriptOfPage() {
  const text = document.querySelector('script[type=module]').textContent;
  return { place: URL.createObjectURL(new Blob([text], { type: 'text/javascript' })), type: 'classic' };
}

/** What is wrong, as a sentence. */
export function sentence({ message }) {
  const text = message ? message[0].toUpperCase() + message.slice(1) : 'Something has failed';
  return /[.!?]$/.test(text) ? text : `${text}.`;
}
