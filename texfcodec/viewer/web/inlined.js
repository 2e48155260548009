// What an exported page carries in itself (viewer/page.py): assets, decoder and light, deflated and written in base 85.

const DIGITS = '0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~';

/** Whether the page stands alone: there is no server to ask. */
export function isExported() {
  return document.getElementById('about') !== null;
}

/** Text of an element that the page carries. */
export function inlinedText(id) {
  return document.getElementById(id).textContent;
}

/** ArrayBuffer of what the page carries under an id, deflated and in base 85. */
export async function inlined(id) {
  const stream = new Blob([bytesOfBase85(inlinedText(id))]).stream().pipeThrough(new DecompressionStream('deflate'));
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
