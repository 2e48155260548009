/** Changed glTF files for fuzz_container.mjs: trees, numbers in their text, bytes, lengths, ends. */

const ODD_VALUES = [null, true, false, 0, 1, -1, 2, 3, 1.5, -0.5, 1e308, '', 'a', '\0', '\ud800', '../..', 'constructor', '__proto__', 'SCALAR', 'VEC2', 'VEC4', 5120, 5123, 5125, 5126,
  [], {}, [0], [[]], {a: 0}, [0, 1, 2], {bufferView: 0}, 127, 128, 255, 256, 65535, 65536, 2 ** 31 - 1, 2 ** 31, 2 ** 32 - 1, 2 ** 32, 2 ** 53, 2 ** 53 + 2, 1e20];
const ODD_NAMES = ['index', 'uri', 'extensions', 'a', 'constructor', '__proto__', 'toString', 'length', 'TEXF_stream', 'sparse', 'bufferView', 'normalTexture'];
const ODD_NUMBERS = ['1e999', '-1e999', '-0', '1.0', '0.1e1', '1e-400', '99999999999999999999', '"0"', 'null', '-1', '[0]', 'nan'];
const JSON_CHUNK = 0x4E4F534A, BINARY_CHUNK = 0x004E4942;

/** Choices of an input, by mulberry32. */
export class Chance {
  /** @param {number} seed @param {number} n */
  constructor(seed, n) {
    this.state = Math.imul(seed, 0x9E3779B1) ^ Math.imul(n + 1, 0x85EBCA6B);
  }

  /** A whole number below `count`. @param {number} count */
  below(count) {
    this.state = (this.state + 0x6D2B79F5) | 0;
    let t = Math.imul(this.state ^ (this.state >>> 15), 1 | this.state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return Math.floor((((t ^ (t >>> 14)) >>> 0) / 2 ** 32) * count);
  }

  /** @template T @param {ArrayLike<T>} options @returns {T} */
  pick(options) {
    return options[this.below(options.length)];
  }
}

/** The tree of a GLB and its binary chunk. @param {Uint8Array} file */
export function treeOf(file) {
  const view = new DataView(file.buffer, file.byteOffset), length = view.getUint32(12, true);
  return {root: JSON.parse(new TextDecoder().decode(file.subarray(20, 20 + length))), binary: file.subarray(Math.min(28 + length, file.length))};
}

/** A GLB. @param {string} text @param {Uint8Array} binary */
export function glbOf(text, binary) {
  const json = Buffer.from(text), padding = Buffer.alloc(-json.length & 3, ' '), head = (...numbers) => Buffer.from(new Uint32Array(numbers).buffer);
  const body = [head(json.length + padding.length, JSON_CHUNK), json, padding, head(binary.length, BINARY_CHUNK), binary];
  return new Uint8Array(Buffer.concat([Buffer.from('glTF'), head(2, 12 + body.reduce((sum, part) => sum + part.length, 0)), ...body]));
}

/** Holder and key of everything in a tree. @param {any} tree @returns {[any, string][]} */
const places = (tree) => Object.entries(tree).flatMap(([key, child]) => [[tree, key], ...(child && typeof child === 'object' ? places(child) : [])]);

/** Changes one place of a tree: left out, doubled, swapped, moved by little, odd, or as another file has it. @param {any} tree @param {any} other @param {Chance} chance */
function bend(tree, other, chance) {
  const all = places(tree);
  if (!all.length) return;
  const [holder, key] = chance.pick(all), value = holder[key], kind = chance.below(8), set = (name, content) => Object.defineProperty(holder, name, {value: content, writable: true, enumerable: true, configurable: true});
  if (kind === 0) Array.isArray(holder) ? holder.splice(Number(key), 1) : delete holder[key];
  else if (kind === 1 && Array.isArray(holder)) holder.splice(Number(key), 0, structuredClone(value));
  else if (kind === 2) {
    const mate = chance.pick(Object.keys(holder));
    [holder[key], holder[mate]] = [holder[mate], value];
  } else if (kind <= 4 && typeof value === 'number') holder[key] = value + chance.pick([-16, -4, -2, -1, 1, 2, 4, 16, 1e6]);
  else if (kind === 5 && !Array.isArray(holder)) {
    delete holder[key];
    set(chance.pick(ODD_NAMES), value);
  } else if (kind === 6) {
    const same = places(other).filter(([, name]) => name === key);
    if (same.length) {
      const [from, name] = chance.pick(same);
      set(key, structuredClone(from[name]));
    }
  } else set(key, structuredClone(chance.pick(ODD_VALUES)));
}

/** Bytes with one edit. @param {Uint8Array} bytes @param {Chance} chance */
function edited(bytes, chance) {
  const at = chance.below(bytes.length + 1), length = 1 + chance.below(9), kind = chance.below(6), out = Uint8Array.from(bytes);
  if (kind === 0 && at < out.length) out[at] ^= 1 << chance.below(8);
  else if (kind <= 1) out.fill(chance.below(256), at, at + length);
  else if (kind === 2) return new Uint8Array(Buffer.concat([bytes.subarray(0, at), bytes.subarray(at + length)]));
  else if (kind === 3) return new Uint8Array(Buffer.concat([bytes.subarray(0, at + length), bytes.subarray(at)]));
  else if (kind === 4) return bytes.slice(0, at);
  else new DataView(out.buffer).setUint32(Math.min(at, Math.max(out.length - 4, 0)) & ~3, chance.pick([0, 1, 2 ** 31, 2 ** 32 - 1, 8, bytes.length]), true);
  return out;
}

/** A file with changes in its tree, most often, in its text, its binary chunk or its frame. @param {Uint8Array} file @param {Uint8Array} other @param {Chance} chance */
export function altered(file, other, chance) {
  const {root, binary} = treeOf(file), mate = treeOf(other), bends = chance.below(4);
  for (let i = 0; i < bends; i++) bend(root, mate.root, chance);
  let text = JSON.stringify(root);
  if (chance.below(6) === 0) {
    const all = [...text.matchAll(/-?\d[\d.e+-]*/g)], {index, 0: word} = all.length ? chance.pick(all) : {index: 0, 0: ''};
    text = text.slice(0, index) + chance.pick(ODD_NUMBERS) + text.slice(index + word.length);
  }
  const bytes = chance.below(4) || !binary.length ? binary : edited(chance.below(8) ? binary : mate.binary, chance), result = glbOf(text, bytes);
  return chance.below(16) ? result : edited(result, chance);
}
