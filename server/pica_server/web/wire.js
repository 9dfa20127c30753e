/**
 * The wire, `pica.2`: control messages in msgpack and media frames, as docs/wire.md has them. The
 * relay gives the page its code and checks what others send, so messages are read for their form
 * alone.
 */

export const SUBPROTOCOL = "pica.2";
export const [CONTROL_KIND, MEDIA_KIND] = [1, 2];
const [HEADER_BYTES, TICK_US, TICKS] = [8, 100, 2 ** 21];
const encoder = new TextEncoder();
const decoder = new TextDecoder("utf-8", { fatal: true });

/** What is wrong, in one line. @param {unknown} error */
export const said = (error) => (error instanceof Error ? error.message : String(error));
/** Bytes of base64, also of that for links. @param {string} text */
export const fromBase64 = (text) => Uint8Array.from(
  atob(text.replaceAll("-", "+").replaceAll("_", "/")), (char) => char.charCodeAt(0));

/** What is no message: close with 4000. */
export class WireError extends Error {}

/** Write text, whole numbers below 2^32, true and false, bytes, lists or maps.
 * @param {any} value @returns {number[]} */
function pack(value) {
  if (typeof value === "boolean") return [value ? 0xc3 : 0xc2];
  if (typeof value === "number") {
    if (value < 128) return [value];
    const [high, low] = [Math.floor(value / 65_536), value % 65_536];
    return high ? [0xce, high >> 8, high & 255, low >> 8, low & 255] : sized(0, 0, 0xcc, value);
  }
  if (value instanceof Uint8Array) return [...sized(0, 0, 0xc4, value.length), ...value];
  if (Array.isArray(value)) return [0x90 | value.length, ...value.flatMap(pack)];
  if (typeof value === "string") {
    const text = encoder.encode(value);
    return [...sized(0xa0, 32, 0xd9, text.length), ...text];
  }
  const entries = Object.entries(value);
  return [0x80 | entries.length, ...entries.flat().flatMap(pack)];
}

/** A mark with its size: within the mark, in one byte after it, or in two after the next mark.
 * @type {(mark: number, least: number, wide: number, size: number) => number[]} */
function sized(mark, least, wide, size) {
  if (size < least) return [mark | size];
  return size < 256 ? [wide, size] : [wide + 1, size >> 8, size & 255];
}

/** Read one value. @param {Uint8Array} bytes */
function unpack(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  /** @param {number} size */
  const take = (size) => {
    at += size;
    if (at > bytes.length) throw new RangeError("it is cut off");
    return bytes.slice(at - size, at);
  };
  /** @param {number} size Of bytes: 1, 2 or 4. */
  const number = (size) => take(size).reduce((all, byte) => all * 256 + byte, 0);
  /** @param {number} count @returns {any[]} */
  const list = (count) => Array.from({ length: count }, value);
  /** @param {number} count */
  const map = (count) =>
    Object.fromEntries(Array.from({ length: count }, () => [value(), value()]));
  /** @returns {any} */
  const value = () => {
    const mark = view.getUint8(at++);
    if (mark < 0x80) return mark;
    if (mark < 0x90) return map(mark & 15);
    if (mark < 0xa0) return list(mark & 15);
    if (mark < 0xc0) return decoder.decode(take(mark & 31));
    switch (mark) {
      case 0xc2: case 0xc3: return mark === 0xc3;
      case 0xc4: case 0xc5: return take(number(mark - 0xc3));
      case 0xcc: case 0xcd: case 0xce: return number(1 << (mark - 0xcc));
      case 0xd9: case 0xda: return decoder.decode(take(number(mark - 0xd8)));
      case 0xdc: return list(number(2));
      case 0xde: return map(number(2));
      default: throw new RangeError(`type ${mark} of msgpack has no place here`);
    }
  };
  return value();
}

/** @param {Uint8Array} data @returns {Message} */
export function decodeMessage(data) {
  try {
    const message = unpack(data.subarray(1));
    if (typeof message.type === "string") return message;
  } catch (error) {
    throw new WireError(`no control message: ${error}`);
  }
  throw new WireError("a message without a type");
}

/** @param {Message} message */
export const encodeMessage = (message) => Uint8Array.from([CONTROL_KIND, ...pack(message)]);

/** The frames of a media message, in order. @param {Uint8Array} data
 * @param {(stream: number) => number} expectedUs About what the capture time of a stream is, which
 * the wire carries modulo 209.7 s. */
export function decodeMedia(data, expectedUs) {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  /** @type {Frame[]} */
  const frames = [];
  for (let at = 1; at < data.length;) {
    const begin = at + HEADER_BYTES;
    const word = begin <= data.length ? view.getUint32(at + 4) : 0;
    const end = begin + (word & 2047);
    if (end > data.length) throw new WireError("a frame is cut off");
    const stream = view.getUint16(at);
    const near = Math.floor(expectedUs(stream) / TICK_US);
    const unwrapped = near + modulo((word >>> 11) - near + TICKS / 2, TICKS) - TICKS / 2;
    const capturedUs = (unwrapped >= 0 ? unwrapped : word >>> 11) * TICK_US;
    frames.push(
      { stream, sequence: view.getUint16(at + 2), capturedUs, payload: data.subarray(begin, end) });
    at = end;
  }
  return frames;
}

/** The header of a frame: with a length of 0, what a seal covers.
 * @param {Omit<Frame, "payload">} frame @param {number} length */
export function encodeHeader({ stream, sequence, capturedUs }, length) {
  const header = new Uint8Array(HEADER_BYTES);
  const view = new DataView(header.buffer);
  view.setUint16(0, stream);
  view.setUint16(2, sequence);
  view.setUint32(4, modulo(Math.floor(capturedUs / TICK_US), TICKS) * 2048 + length);
  return header;
}

/** A media message of one frame. @param {Frame} frame */
export const encodeFrame = (frame) => Uint8Array.from(
  [MEDIA_KIND, ...encodeHeader(frame, frame.payload.length), ...frame.payload]);

/** @type {(value: number, divisor: number) => number} */
const modulo = (value, divisor) => ((value % divisor) + divisor) % divisor;
