// Files that are dropped on the page; the server reads them.

import { isExported } from './inlined.js';
import { unpack } from './data.js';

const ALONE = 'This page stands alone and cannot read files: open them with texf-view.';

/** The header of a file, of its container. Throws an Error whose message says what the server refused. */
export async function headerOf(file, takesFiles) {
  if (isExported() || !takesFiles) throw new Error(ALONE);
  const answer = await fetch(`drop?name=${encodeURIComponent(file.name)}`, { method: 'POST', body: file }).catch(() => {
    throw new Error('The server does not answer: has texf-view ended?');
  });
  if (answer.ok) return unpack(await answer.arrayBuffer());
  throw new Error(`${file.name} is not shown. ${await refusalOf(answer)}`);
}

/** Code and words of an answer that is no container. */
async function refusalOf(answer) {
  const text = await answer.text();
  try {
    const { code, message } = JSON.parse(text);
    return `${code}: ${message}`;
  } catch {
    return `${answer.status}: ${text.trim()}`;
  }
}

/** Calls onFile(file, isSecond) for a file that is dropped anywhere on the page; onHover(null, or isSecond) while one is over it. */
export function listenToDrops(canSecond, onFile, onHover) {
  const isSecond = (event) => canSecond() && (event.shiftKey || event.clientX > innerWidth / 2);
  const holdsFile = (event) => event.dataTransfer?.types.includes('Files');
  document.addEventListener('dragover', (event) => {
    if (!holdsFile(event)) return;
    event.preventDefault();
    onHover(isSecond(event));
  });
  document.addEventListener('dragleave', (event) => { if (event.relatedTarget === null) onHover(null); });
  document.addEventListener('drop', (event) => {
    if (!holdsFile(event)) return;
    event.preventDefault();
    onHover(null);
    if (event.dataTransfer.files.length) onFile(event.dataTransfer.files[0], isSecond(event));
  });
}
