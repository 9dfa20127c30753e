/**
 * The part of msgpack that control messages are made of: maps with text keys, lists, text, whole
 * numbers, true and false, bytes. Reading is bounded as `pica_protocol.codec` bounds it.
 *
 * @module
 */

/** @typedef {string | number | boolean | null | Uint8Array | Plain[] | {[key: string]: Plain}} Plain */

const MAX_TEXT_BYTES = 2048;
const MAX_BYTES = 512;
const MAX_ITEMS = 64;
const MAX_FIELDS = 16;
/** Deeper values are in no message; Python's reader stops at its own depth. */
const MAX_DEPTH = 32;

const utf8 = new TextEncoder();
const strictUtf8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

/**
 * Write a value.
 *
 * @param {Plain} value
 * @returns {number[]}
 */
export function pack(value) {
  if (value === null) return [0xc0];
  if (typeof value === "boolean") return [value ? 0xc3 : 0xc2];
  if (typeof value === "number") return packNumber(value);
  if (typeof value === "string") {
    const text = utf8.encode(value);
    const size = text.length;
    return [...(size < 32 ? [0xa0 | size] : sized(0xd9, size)), ...text];
  }
  if (value instanceof Uint8Array) return [...sized(0xc4, value.length), ...value];
  if (Array.isArray(value)) {
    const count = value.length;
    return [...(count < 16 ? [0x90 | count] : [0xdc, count >> 8, count & 255]), ...value.flatMap(pack)];
  }
  const entries = Object.entries(value);
  if (entries.length >= 16) throw new RangeError("a map of more than 15 fields");
  return [0x80 | entries.length, ...entries.flatMap(([key, item]) => [...pack(key), ...pack(item)])];
}

/** @param {number} value @returns {number[]} */
function packNumber(value) {
  if (!Number.isInteger(value) || value < 0 || value > 0xffffffff) {
    throw new RangeError(`${value} is in no message`);
  }
  if (value < 128) return [value];
  if (value < 256) return [0xcc, value];
  if (value < 65536) return [0xcd, value >> 8, value & 255];
  return [0xce, value >>> 24, (value >> 16) & 255, (value >> 8) & 255, value & 255];
}

/** @param {number} mark That of one byte of size. @param {number} size @returns {number[]} */
function sized(mark, size) {
  return size < 256 ? [mark, size] : [mark + 1, size >> 8, size & 255];
}

/**
 * Read one value that fills all bytes; throws an `Error` for anything else.
 *
 * @param {Uint8Array} bytes
 * @returns {Plain}
 */
export function unpack(bytes) {
  const reader = new Reader(bytes);
  const value = reader.value(0);
  if (reader.at !== bytes.length) throw new Error(`${bytes.length - reader.at} bytes too many`);
  return value;
}

class Reader {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
  }

  /** @param {number} depth @returns {Plain} */
  value(depth) {
    if (depth > MAX_DEPTH) throw new Error("nested too deep");
    const mark = this.number(1);
    if (mark < 0x80) return mark;
    if (mark < 0x90) return this.map(mark & 15, depth);
    if (mark < 0xa0) return this.list(mark & 15, depth);
    if (mark < 0xc0) return this.text(mark & 31);
    if (mark >= 0xe0) return mark - 256;
    switch (mark) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: case 0xc5: case 0xc6:
        return this.take(this.size(1 << (mark - 0xc4), MAX_BYTES)).slice();
      case 0xca: case 0xcb: // no field is a fraction, so it is as good as nothing
        this.take(4 << (mark - 0xca));
        return null;
      case 0xcc: case 0xcd: case 0xce: return this.number(1 << (mark - 0xcc));
      case 0xcf: return Number(this.view.getBigUint64(this.advance(8)));
      case 0xd0: return this.view.getInt8(this.advance(1));
      case 0xd1: return this.view.getInt16(this.advance(2));
      case 0xd2: return this.view.getInt32(this.advance(4));
      case 0xd3: return Number(this.view.getBigInt64(this.advance(8)));
      case 0xd9: case 0xda: case 0xdb:
        return this.text(this.size(1 << (mark - 0xd9), MAX_TEXT_BYTES));
      case 0xdc: case 0xdd: return this.list(this.size(2 << (mark - 0xdc), MAX_ITEMS), depth);
      case 0xde: case 0xdf: return this.map(this.size(2 << (mark - 0xde), MAX_FIELDS), depth);
      default: throw new Error(`type ${mark} of msgpack has no place here`);
    }
  }

  /** @param {number} count @returns {number} Where they begin. */
  advance(count) {
    const begin = this.at;
    if (begin + count > this.bytes.length) throw new Error("cut off");
    this.at = begin + count;
    return begin;
  }

  /** @param {number} count @returns {Uint8Array} */
  take(count) {
    const begin = this.advance(count);
    return this.bytes.subarray(begin, begin + count);
  }

  /** @param {number} count Of bytes, 4 at most. @returns {number} */
  number(count) {
    return this.take(count).reduce((value, byte) => value * 256 + byte, 0);
  }

  /** @param {number} count Of bytes. @param {number} limit @returns {number} */
  size(count, limit) {
    const size = this.number(count);
    if (size > limit) throw new Error(`${size} items or bytes; the limit is ${limit}`);
    return size;
  }

  /** @param {number} size @returns {string} */
  text(size) {
    return strictUtf8.decode(this.take(size));
  }

  /** @param {number} count @param {number} depth @returns {Plain[]} */
  list(count, depth) {
    return Array.from({ length: count }, () => this.value(depth + 1));
  }

  /** @param {number} count @param {number} depth @returns {{[key: string]: Plain}} */
  map(count, depth) {
    /** @type {{[key: string]: Plain}} */
    const found = Object.create(null);
    for (let i = 0; i < count; i++) {
      const key = this.value(depth + 1);
      if (typeof key !== "string") throw new Error("a key that is no text");
      if (key in found) throw new Error("a key twice in a map");
      found[key] = this.value(depth + 1);
    }
    return found;
  }
}
