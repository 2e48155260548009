// What an exported page carries in itself (viewer/page.py): containers, deflated and written in base 85, and how it begins.

const DIGITS = '0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~';

/** Whether the page stands alone: there is no server to ask. */
export function isExported() {
  return document.getElementById('about') !== null;
}

/** What a server answers to `about`, of an exported page. */
export function inlinedAbout() {
  return JSON.parse(document.getElementById('about').textContent);
}

/** ArrayBuffer of the container of asset `number` of an exported page. */
export async function inlinedContainer(number) {
  const element = document.getElementById(`asset-${number}`);
  const packed = bytesOfBase85(element.textContent);
  element.remove();
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Response(stream).arrayBuffer();
}

/** Uint8Array of a text in which five digits stand for four bytes; of the last digits, one fewer bytes than digits. */
export function bytesOfBase85(text) {
  const values = new Uint8Array(128);
  for (let i = 0; i < DIGITS.length; i++) values[DIGITS.charCodeAt(i)] = i;
  const whole = Math.ceil(text.length / 5);
  const out = new DataView(new ArrayBuffer(4 * whole));
  for (let i = 0; i < whole; i++) {
    let word = 0;
    for (let j = 5 * i; j < 5 * i + 5; j++) word = 85 * word + (j < text.length ? values[text.charCodeAt(j)] : 84);
    out.setUint32(4 * i, word);
  }
  return new Uint8Array(out.buffer, 0, 4 * whole - (5 * whole - text.length));
}
