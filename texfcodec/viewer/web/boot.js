// An exported page begins here: it unpacks what it holds (viewer/page.py), deflated and in base 85, and runs the viewer.
(() => {
  const DIGITS = '0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~', values = new Uint8Array(128);
  for (let i = 0; i < DIGITS.length; i++) values[DIGITS.charCodeAt(i)] = i;

  /** Uint8Array of a text in which five digits stand for four bytes; of the last digits, one fewer bytes than digits. */
  function bytesOfBase85(text) {
    const whole = Math.ceil(text.length / 5), out = new DataView(new ArrayBuffer(4 * whole));
    for (let i = 0; i < whole; i++) {
      let word = 0;
      for (let j = 5 * i; j < 5 * i + 5; j++) word = 85 * word + (j < text.length ? values[text.charCodeAt(j)] : 84);
      out.setUint32(4 * i, word);
    }
    return new Uint8Array(out.buffer, 0, 4 * whole - (5 * whole - text.length));
  }

  /** ArrayBuffer of what the page holds under a name. */
  globalThis.texfHeld = (name) => {
    const stream = new Blob([bytesOfBase85(document.getElementById(name).textContent)]).stream();
    return new Response(stream.pipeThrough(new DecompressionStream('deflate'))).arrayBuffer();
  };
  globalThis.texfHeld('viewer').then((text) => {
    const script = document.createElement('script');
    script.textContent = new TextDecoder().decode(text);
    document.head.append(script);
  });
})();
