/**
 * The wire, `pica.2`: control messages and media frames, as docs/wire.md has them. What a relay
 * sends is checked as strictly as the Python client checks it; unknown fields are ignored.
 *
 * @module
 */

import { pack, unpack } from "./msgpack.js";

/** @import { Plain } from "./msgpack.js" */

export const SUBPROTOCOL = "pica.2";
export const CONTROL_KIND = 1;
export const MEDIA_KIND = 2;
const MAX_CONTROL_BYTES = 131_072;
const MAX_MEDIA_BYTES = 16_384;
const MAX_FRAME_BYTES = 1200;
const HEADER_BYTES = 8;
const TICK_US = 100;
const TICKS = 2 ** 21;
const MAX_PEERS = 64;

/** What is no message: close with 4000. */
export class WireError extends Error {}

/**
 * @typedef {{kind: string, policy: string, avatar: string, stream: number,
 *     deadline_ms: number}} Track
 * @typedef {{peer_id: string, name: string, tracks: Track[], metadata: Record<string, string>,
 *     identity: string, is_name_assured: boolean}} Peer
 * @typedef {{stream: number, sequence: number, capturedUs: number, payload: Uint8Array}} Frame
 * @typedef {{type: string, [field: string]: any}} Message
 * @typedef {(value: any, field: string) => any} Check Returns what is meant, or throws.
 */

/** @param {boolean} holds @param {string} field @param {string} wanted */
function require_(holds, field, wanted) {
  if (!holds) throw new WireError(`${field} must be ${wanted}`);
}

const utf8 = new TextEncoder();

/** @param {number} limit @param {boolean} [needed] @returns {Check} */
const text = (limit, needed = false) => (value, field) => {
  const isText = typeof value === "string" && !/(?! )[\p{C}\p{Z}]/u.test(value);
  require_(isText, field, "printable text");
  require_(utf8.encode(value).length <= limit, field, `at most ${limit} bytes`);
  require_(!needed || value.trim() !== "", field, "not empty");
  return value;
};

/** @param {RegExp} pattern @param {string} wanted @returns {Check} */
const matching = (pattern, wanted) => (value, field) => {
  require_(typeof value === "string" && pattern.test(value), field, wanted);
  return value;
};

/** @param {number} low @param {number} high @returns {Check} */
const whole = (low, high) => (value, field) => {
  const isWhole = Number.isInteger(value) && value >= low && value <= high;
  require_(isWhole, field, `a whole number in ${low}..${high}`);
  return value;
};

/** @param {Check} item @param {number} limit @returns {Check} */
const list = (item, limit) => (value, field) => {
  require_(Array.isArray(value) && value.length <= limit, field, `a list of at most ${limit}`);
  return value.map((/** @type {Plain} */ each, /** @type {number} */ i) => item(each, `${field}[${i}]`));
};

/** @type {Check} */
const flag = (value, field) => {
  require_(typeof value === "boolean", field, "true or false");
  return value;
};

/** @type {Check} */
const bytes = (value, field) => {
  require_(value instanceof Uint8Array && value.length <= 512, field, "at most 512 bytes");
  return value;
};

const token = matching(/^[A-Za-z0-9_.-]{1,64}$/, "1 to 64 of A-Z a-z 0-9 _ . -");
const tokenIfAny = matching(/^[A-Za-z0-9_.-]{0,64}$/, "at most 64 of A-Z a-z 0-9 _ . -");
const kind = matching(/^[A-Za-z0-9_.-]{1,16}$/, "1 to 16 of A-Z a-z 0-9 _ . -");
const pass = matching(/^[A-Za-z0-9_.-]{0,2048}$/, "at most 2048 of A-Z a-z 0-9 _ . -");
const sha256 = matching(/^([0-9a-f]{64})?$/, "a SHA-256 or empty");
const relayUrl = matching(
  /^$|^(?=.{0,256}$)wss?:\/\/([A-Za-z0-9.-]+|\[[0-9a-fA-F:.]+\])(:\d{1,5})?(\/[!-~]*)?$/,
  "a relay's address or empty");
const streamNumber = whole(1, 65_535);
/** @type {Check} */
const byeCode = (value, field) => {
  require_([1000, 1001, 1009, 1011].includes(value) || (value >= 3000 && value <= 4999), field,
    "a code of closing");
  return whole(1000, 4999)(value, field);
};

/** @type {Check} */
const metadata = (value, field) => {
  require_(isMap(value) && Object.keys(value).length <= 8, field, "a map of at most 8 entries");
  for (const [key, item] of Object.entries(value)) {
    kind(key, `${field} key`);
    text(64)(item, `${field}.${key}`);
  }
  return { ...value };
};

/** @param {any} value @returns {boolean} */
function isMap(value) {
  return typeof value === "object" && value !== null && !Array.isArray(value)
    && !(value instanceof Uint8Array);
}

/** @param {Record<string, [Check, any?]>} fields Check and default; without: needed. @returns {Check} */
const record = (fields) => (value, field) => {
  require_(isMap(value), field, "a map");
  /** @type {Record<string, any>} */
  const found = {};
  for (const [name, [check, ...defaults]] of Object.entries(fields)) {
    require_(name in value || defaults.length > 0, `${field}.${name}`, "there");
    found[name] = name in value ? check(value[name], `${field}.${name}`) : defaults[0];
  }
  return found;
};

/** @type {Check} */
const track = (value, field) => {
  const found = record({
    kind: [kind],
    policy: [matching(/^(latest|ordered)$/, "latest or ordered"), "latest"],
    avatar: [sha256, ""],
    stream: [streamNumber],
    deadline_ms: [whole(0, 10_000), 0],
  })(value, field);
  const isOrdered = found.policy === "ordered";
  require_(isOrdered === found.deadline_ms > 0, `${field}.deadline_ms`, "said of ordered tracks");
  return found;
};

const peer = record({
  peer_id: [token],
  name: [text(64, true)],
  tracks: [list(track, 4), []],
  metadata: [metadata, {}],
  identity: [tokenIfAny, ""],
  is_name_assured: [flag, false],
});

/** What a relay says, by type. @type {Record<string, Check>} */
const MESSAGES = {
  joined: record({
    room: [token],
    peer_id: [token],
    tracks: [list(track, 4), []],
    peers: [list(peer, MAX_PEERS), []],
    resumed: [flag, false],
    resume: [pass, ""],
    name: [text(64), ""],
    is_admin: [flag, false],
  }),
  peer_joined: record({ peer: [peer] }),
  peer_left: record({ peer_id: [token], reason: [text(120), ""] }),
  peer_away: record({ peer_id: [token] }),
  peer_back: record({ peer_id: [token] }),
  peer_updated: record({ peer_id: [token], metadata: [metadata, {}] }),
  stream_muted: record({ stream: [streamNumber], is_muted: [flag] }),
  whisper: record({ peer_id: [token], data: [bytes] }),
  bye: record({ code: [byeCode], reason: [text(120), ""], url: [relayUrl, ""] }),
};

/**
 * Read a control message of a relay; throws a `WireError` that names what is wrong.
 *
 * @param {Uint8Array} data
 * @returns {Message}
 */
export function decodeMessage(data) {
  if (data.length > MAX_CONTROL_BYTES) throw new WireError(`control message of ${data.length} bytes`);
  /** @type {any} */
  let value;
  try {
    value = unpack(data.subarray(1));
  } catch (error) {
    throw new WireError(`no control message: ${error}`);
  }
  const type = isMap(value) ? value.type : undefined;
  if (typeof type !== "string" || !Object.hasOwn(MESSAGES, type)) {
    throw new WireError("a message of an unknown type");
  }
  return { type, ...MESSAGES[type](value, type) };
}

/** @param {Message} message @returns {Uint8Array<ArrayBuffer>} */
export function encodeMessage(message) {
  return Uint8Array.from([CONTROL_KIND, ...pack(message)]);
}

/**
 * Read the frames of a media message, in order.
 *
 * @param {Uint8Array} data
 * @param {(stream: number) => number} expectedUs About what the capture time of a stream is: the
 *     wire carries it modulo 209.7 s.
 * @returns {Frame[]}
 */
export function decodeMedia(data, expectedUs) {
  if (data.length > MAX_MEDIA_BYTES || data.length < 1 + HEADER_BYTES) {
    throw new WireError(`media message of ${data.length} bytes`);
  }
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const frames = [];
  for (let at = 1, end = 0; at < data.length; at = end) {
    if (data.length - at < HEADER_BYTES) throw new WireError("frame header cut off");
    const word = view.getUint32(at + 4);
    const stream = view.getUint16(at);
    const sequence = view.getUint16(at + 2);
    end = at + HEADER_BYTES + (word & 2047);
    if (end > data.length || end - at > MAX_FRAME_BYTES || !stream) {
      throw new WireError(`frame of stream ${stream} with ${word & 2047} bytes`);
    }
    const capturedUs = unwrapUs(word >>> 11, expectedUs(stream));
    frames.push({ stream, sequence, capturedUs, payload: data.subarray(at + HEADER_BYTES, end) });
  }
  return frames;
}

/** @param {number} ticks @param {number} nearUs @returns {number} */
function unwrapUs(ticks, nearUs) {
  const near = Math.floor(nearUs / TICK_US);
  const unwrapped = near + modulo(ticks - near + TICKS / 2, TICKS) - TICKS / 2;
  return (unwrapped >= 0 ? unwrapped : ticks) * TICK_US;
}

/**
 * The header of a frame: with a length of 0, what a seal covers.
 *
 * @param {Omit<Frame, "payload">} frame
 * @param {number} length Of the payload, in bytes.
 * @returns {Uint8Array}
 */
export function encodeHeader({ stream, sequence, capturedUs }, length) {
  const header = new Uint8Array(HEADER_BYTES);
  const view = new DataView(header.buffer);
  view.setUint16(0, stream);
  view.setUint16(2, sequence);
  view.setUint32(4, modulo(Math.floor(capturedUs / TICK_US), TICKS) * 2048 + length);
  return header;
}

/** @param {Frame} frame @returns {Uint8Array<ArrayBuffer>} A media message of one frame. */
export function encodeFrame(frame) {
  const header = encodeHeader(frame, frame.payload.length);
  return Uint8Array.from([MEDIA_KIND, ...header, ...frame.payload]);
}

/** @param {number} value @param {number} divisor @returns {number} */
function modulo(value, divisor) {
  return ((value % divisor) + divisor) % divisor;
}
