/**
 * The latent stream: a few bytes to a face, and back. Every frame is decoded alone, in whole
 * numbers below 2^53, which floats hold exactly; so all receivers see the same latents.
 *
 * The format is that of docs/wire.md; `pica_core.codec` is the Python side.
 *
 * @module
 */

/** @import { AvatarFile, LatentSample, Tensor } from "./types.js" */

const NUM_LATENT = 256;
const NUM_POSE = 6;
const TOTAL_BITS = 14;
const TOTAL = 1 << TOTAL_BITS;
const FULL_RANGE = 2 ** 48;
const LEAST_RANGE = 2 ** 40;
const MAX_PAYLOAD_BYTES = 512;
const ESCAPE = 20;
const ACTIVITY_LEVELS = [1, 4, 9, 20, 40];
const ACTIVITY_WINDOW = 16;
const MAX_REST_BITS = 13;
const HAS_LATENT = 1;
const HAS_POSE = 2;
const IS_STILL = 4;
const POSE_UNIT = 2 ** -14;
const LATENT_UNIT = 2 ** -12;
const MAX_LATENT = 1 << 20;
const MAX_COEFFICIENT = 1 << 16;
/** Longer latents are shortened to this. */
const MAX_LENGTH = 128;
/** By quality, of latent, rotation and translation. */
const STEPS = [
  [80, 24, 5], [64, 20, 4], [48, 14, 3], [36, 12, 2], [28, 10, 2], [20, 8, 2], [14, 6, 1],
  [10, 4, 1],
];
const DEFAULT_QUALITY = 3;
/** A bit less is worth so much more squared error of the latent, in squared steps. */
const BIT_PRICE = 0.12;

/** What cannot be read as a frame. */
export class LatentError extends Error {}

/** Frequencies of one alphabet, and the symbol of each slot. */
class Table {
  /** @param {readonly number[]} frequencies Which sum to `TOTAL`. */
  constructor(frequencies) {
    this.frequencies = frequencies;
    /** @type {number[]} */
    this.starts = [];
    this.symbols = new Uint8Array(TOTAL);
    let start = 0;
    frequencies.forEach((frequency, symbol) => {
      this.starts.push(start);
      this.symbols.fill(symbol, start, start + frequency);
      start += frequency;
    });
  }
}

const QUALITY_TABLE = new Table([192, 192, 192, 11426, 3810, 191, 191, 190]);
const HEADER_TABLE = new Table([1, 2886, 2, 13169, 1, 59, 1, 265]);
const ROTATION_TABLE = new Table(
  [4599, 1900, 1350, 1850, 2450, 2150, 1450, 540, 60, 20, 8, 2, 2, 1, 1, 1]);
const TRANSLATION_TABLE = new Table(
  [4199, 2400, 1950, 2400, 2500, 1800, 860, 220, 30, 12, 6, 2, 2, 1, 1, 1]);

/** @type {Map<number, Table>} */
const coefficientTables = new Map();

/** @param {number} index 11 a + b. @returns {Table} */
export function coefficientTable(index) {
  let table = coefficientTables.get(index);
  if (table === undefined) {
    const zero = 1 + 3 * Math.floor(index / 11);
    const ratio = 1 + 3 * (index % 11);
    const weights = [2 ** 30];
    while (weights.length < ESCAPE) {
      weights.push(Math.floor((weights[weights.length - 1] * ratio) / 32));
    }
    weights[ESCAPE - 1] = Math.floor((weights[ESCAPE - 1] * 32) / (32 - ratio));
    const sum = weights.reduce((a, b) => a + b);
    const spare = (TOTAL - 2 * ESCAPE - 1) * (32 - zero);
    // Products reach 2^49 and the divisor 2^41: the quotient of floats rounds to no other integer.
    const sides = weights.map((weight) => 1 + Math.floor((spare * weight) / (64 * sum)));
    const middle = TOTAL - 2 * sides.reduce((a, b) => a + b);
    table = new Table([middle, ...sides.flatMap((side) => [side, side])]);
    coefficientTables.set(index, table);
  }
  return table;
}

/** Takes the symbols of one payload, in order. */
class SymbolReader {
  /** @param {Uint8Array} payload */
  constructor(payload) {
    if (payload.length > MAX_PAYLOAD_BYTES) {
      throw new LatentError(`payload of ${payload.length} bytes; the limit is ${MAX_PAYLOAD_BYTES}`);
    }
    if (payload.length && !payload[payload.length - 1]) {
      throw new LatentError("payload ends with a zero byte");
    }
    this.payload = payload;
    this.next = 6;
    this.width = FULL_RANGE;
    this.code = 0;
    for (let i = 0; i < 6; i++) this.code = this.code * 256 + (payload[i] ?? 0);
  }

  slot() {
    this.width = Math.floor(this.width / TOTAL);
    const slot = Math.floor(this.code / this.width);
    if (slot >= TOTAL) throw new LatentError("payload holds a code that no encoder writes");
    return slot;
  }

  /** @param {number} start @param {number} frequency */
  take(start, frequency) {
    this.code -= start * this.width;
    this.width *= frequency;
    while (this.width < LEAST_RANGE) {
      this.code = this.code * 256 + (this.payload[this.next] ?? 0);
      this.width *= 256;
      this.next += 1;
    }
  }

  /** @param {Table} table @returns {number} */
  read(table) {
    const symbol = table.symbols[this.slot()];
    this.take(table.starts[symbol], table.frequencies[symbol]);
    return symbol;
  }

  /** @param {number} bits @returns {number} */
  readUniform(bits) {
    const width = TOTAL >> bits;
    const value = Math.floor(this.slot() / width);
    this.take(value * width, width);
    return value;
  }

  finish() {
    if (this.payload.length > this.next) throw new LatentError("payload has bytes too many");
  }
}

/** The five `stream.*` tensors of an avatar file: type, least and largest value. */
const ARRAYS = /** @type {const} */ ({
  mean: ["I32", -MAX_LATENT, MAX_LATENT],
  analysis: ["I16", -(2 ** 15), 2 ** 15 - 1],
  synthesis: ["I16", -(2 ** 15), 2 ** 15 - 1],
  synthesis_shift: ["I32", 0, 24],
  table_index: ["U8", 0, 120],
});

/** What a frame's coefficients mean for one avatar, and how likely they are. */
export class StreamProfile {
  /**
   * Throws an `Error` that names what is missing or out of its limits.
   *
   * @param {AvatarFile["tensors"]} tensors
   */
  constructor(tensors) {
    const count = tensors.get("stream.table_index")?.shape[0] ?? 0;
    if (count < 1 || count > 128) throw new Error(`stream.table_index has ${count} rows`);
    /** @type {Record<keyof typeof ARRAYS, readonly number[]>} */
    const shapes = {
      mean: [NUM_LATENT], analysis: [NUM_LATENT, count], synthesis: [count, NUM_LATENT],
      synthesis_shift: [1], table_index: [count, 6],
    };
    /** @param {keyof typeof ARRAYS} name @returns {Tensor["data"]} */
    const checked = (name) => {
      const tensor = tensors.get(`stream.${name}`);
      const [dtype, low, high] = ARRAYS[name];
      if (tensor?.dtype !== dtype || String(tensor.shape) !== String(shapes[name])) {
        throw new Error(`stream.${name} must be ${dtype} [${shapes[name]}]`);
      }
      if (!tensor.data.every((value) => value >= low && value <= high)) {
        throw new Error(`stream.${name} must be in ${low}..${high}`);
      }
      return tensor.data;
    };
    for (const name of tensors.keys()) {
      if (name.startsWith("stream.") && !(name.slice(7) in ARRAYS)) {
        throw new Error(`tensor ${name.slice(0, 80)} is unknown`);
      }
    }
    this.mean = checked("mean");
    this.analysis = checked("analysis");
    this.synthesis = checked("synthesis");
    this.scale = 2 ** checked("synthesis_shift")[0];
    this.count = count;
    const index = checked("table_index");
    this.tables = Array.from({ length: count }, (_, k) =>
      Array.from(index.slice(6 * k, 6 * k + 6), coefficientTable));
  }

  /** @param {ArrayLike<number>} coefficients The first `count`. @returns {Float32Array} */
  synthesise(coefficients) {
    const { mean, synthesis, scale, count } = this;
    const latent = new Float32Array(NUM_LATENT);
    const half = Math.floor(scale / 2);
    for (let i = 0; i < NUM_LATENT; i++) {
      let sum = 0;
      for (let k = 0; k < count; k++) sum += synthesis[k * NUM_LATENT + i] * coefficients[k];
      latent[i] = clamp(Math.floor((sum + half) / scale) + mean[i], MAX_LATENT) * LATENT_UNIT;
    }
    return latent;
  }

  /** @param {Float32Array} latent @returns {number[]} */
  analyse(latent) {
    const offset = Array.from(latent, (value, i) =>
      clamp(roundHalfEven(value / LATENT_UNIT), MAX_LATENT) - this.mean[i]);
    return Array.from({ length: this.count }, (_, k) => {
      const sum = offset.reduce((all, value, i) => all + value * this.analysis[i * this.count + k], 0);
      return clamp(Math.floor((sum + 2 ** 15) / 2 ** 16), MAX_COEFFICIENT / 2);
    });
  }
}

/**
 * Read the coefficients of one frame; throws a `LatentError` if no encoder wrote it.
 *
 * @param {StreamProfile} profile
 * @param {Uint8Array} payload
 * @returns {{coefficients: number[], isStill: boolean}}
 */
export function decodeFrame(profile, payload) {
  const reader = new SymbolReader(payload);
  const steps = stepsOf(reader.read(QUALITY_TABLE), profile.count);
  const header = reader.read(HEADER_TABLE);
  const values = new Array(profile.count + NUM_POSE).fill(0);
  if (header & HAS_LATENT) readFace(reader, values, profile.tables);
  for (let i = 0; header & HAS_POSE && i < NUM_POSE; i++) {
    const length = reader.read(i < 3 ? ROTATION_TABLE : TRANSLATION_TABLE);
    if (!length) continue;
    const sign = reader.readUniform(1) ? -1 : 1;
    values[profile.count + i] = sign * (2 ** (length - 1) + reader.readUniform(length - 1));
  }
  reader.finish();
  const coefficients = values.map((value, i) => value * steps[i]);
  if (coefficients.some((value) => Math.abs(value) > MAX_COEFFICIENT)) {
    throw new LatentError(`a coefficient is beyond the limit of ${MAX_COEFFICIENT}`);
  }
  return { coefficients, isStill: Boolean(header & IS_STILL) };
}

/** @param {SymbolReader} reader @param {number[]} values @param {readonly Table[][]} tables */
function readFace(reader, values, tables) {
  let activity = 0;
  tables.forEach((contexts, place) => {
    const symbol = reader.read(contexts[contextOf(activity)]);
    let magnitude = (symbol + 1) >> 1;
    if (magnitude >= ESCAPE) {
      const length = reader.readUniform(4);
      if (length > MAX_REST_BITS) throw new LatentError(`a rest of ${length} bits`);
      magnitude += 2 ** length + reader.readUniform(length) - 1;
    }
    values[place] = symbol & 1 ? magnitude : 0 - magnitude;
    activity += magnitude - Math.abs(values[place - ACTIVITY_WINDOW] ?? 0);
  });
}

/**
 * @param {StreamProfile} profile
 * @param {Uint8Array} payload
 * @returns {LatentSample}
 */
export function decodeFace(profile, payload) {
  const { coefficients, isStill } = decodeFrame(profile, payload);
  const latent = profile.synthesise(coefficients);
  const length = Math.sqrt(latent.reduce((sum, value) => sum + value * value, 0));
  if (length > MAX_LENGTH) latent.forEach((value, i) => (latent[i] = value * (MAX_LENGTH / length)));
  const pose = Float32Array.from(coefficients.slice(profile.count), (value) => value * POSE_UNIT);
  return { latent, rotation: pose.slice(0, 3), translation: pose.slice(3), isStill };
}

/**
 * Write a face as one frame, at the quality that senders use.
 *
 * @param {StreamProfile} profile
 * @param {{latent: Float32Array, rotation: ArrayLike<number>, translation: ArrayLike<number>}} face
 * @returns {Uint8Array}
 */
export function encodeFace(profile, { latent, rotation, translation }) {
  const pose = [
    ...Array.from(rotation, (value) => clamp(value, Math.PI)),
    ...Array.from(translation, (value) => clamp(value, 1)),
  ].map((value) => roundHalfEven(value / POSE_UNIT));
  const steps = stepsOf(DEFAULT_QUALITY, profile.count);
  const exact = profile.analyse(latent);
  const values = [...exact, ...pose].map((value, i) =>
    Math.sign(value) * Math.floor((2 * Math.abs(value) + steps[i]) / (2 * steps[i])));
  const face = values.slice(0, profile.count);
  spareBits(face, exact, steps[0], profile.tables);
  const turned = values.slice(profile.count);
  const header = (face.some(Boolean) ? HAS_LATENT : 0) | (turned.some(Boolean) ? HAS_POSE : 0);
  /** @type {[number, number][]} */
  const ranges = [rangeOf(QUALITY_TABLE, DEFAULT_QUALITY), rangeOf(HEADER_TABLE, header)];
  if (header & HAS_LATENT) writeFace(ranges, face, profile.tables);
  for (let i = 0; header & HAS_POSE && i < NUM_POSE; i++) {
    const magnitude = Math.abs(turned[i]);
    const length = bitLength(magnitude);
    ranges.push(rangeOf(i < 3 ? ROTATION_TABLE : TRANSLATION_TABLE, length));
    if (length) {
      ranges.push(uniform(turned[i] < 0 ? 1 : 0, 1));
      ranges.push(uniform(magnitude - 2 ** (length - 1), length - 1));
    }
  }
  return writeSymbols(ranges);
}

/**
 * Rounds coefficients in steps towards 0 where the bits are worth the error.
 *
 * @param {number[]} values Rounded to the nearest; changed in place.
 * @param {ArrayLike<number>} exact
 * @param {number} step
 * @param {readonly Table[][]} tables
 */
function spareBits(values, exact, step, tables) {
  let activity = 0;
  values.forEach((value, place) => {
    let magnitude = Math.abs(value);
    const grown = 1 - 2 * (magnitude - Math.abs(exact[place]) / step);
    if (grown < 1 && magnitude > 0 && magnitude < ESCAPE) {
      const { frequencies } = tables[place][contextOf(activity)];
      const sign = value > 0 ? 1 : 0;
      const cheap = frequencies[magnitude > 1 ? 2 * (magnitude - 1) - sign : 0];
      if (BIT_PRICE * Math.log2(cheap / frequencies[2 * magnitude - sign]) > grown) {
        magnitude -= 1;
        values[place] = Math.sign(value) * magnitude;
      }
    }
    activity += magnitude - Math.abs(values[place - ACTIVITY_WINDOW] ?? 0);
  });
}

/** @param {[number, number][]} ranges @param {number[]} values @param {readonly Table[][]} tables */
function writeFace(ranges, values, tables) {
  let activity = 0;
  values.forEach((value, place) => {
    const magnitude = Math.abs(value);
    const symbol = 2 * Math.min(magnitude, ESCAPE) - (value > 0 ? 1 : 0);
    ranges.push(rangeOf(tables[place][contextOf(activity)], symbol));
    if (magnitude >= ESCAPE) {
      const rest = magnitude - ESCAPE + 1;
      const length = bitLength(rest) - 1;
      ranges.push(uniform(length, 4), uniform(rest - 2 ** length, length));
    }
    activity += magnitude - Math.abs(values[place - ACTIVITY_WINDOW] ?? 0);
  });
}

/** @param {[number, number][]} ranges Start and frequency of each symbol. @returns {Uint8Array} */
function writeSymbols(ranges) {
  let low = 0n;
  let width = BigInt(FULL_RANGE);
  let bits = 48n;
  for (const [start, frequency] of ranges) {
    width >>= 14n;
    low += BigInt(start) * width;
    width *= BigInt(frequency);
    while (width < LEAST_RANGE) {
      width <<= 8n;
      low <<= 8n;
      bits += 8n;
    }
  }
  let shift = bits; // as few bytes as reach into the interval
  let code = 0n;
  while ((code = (low + (1n << shift) - 1n) >> shift) << shift >= low + width) shift -= 8n;
  const payload = new Uint8Array(Number((bits - shift) / 8n));
  for (let i = payload.length - 1; i >= 0; i--, code >>= 8n) payload[i] = Number(code & 255n);
  return payload;
}

/** @param {number} quality @param {number} count @returns {number[]} */
function stepsOf(quality, count) {
  const [face, rotation, translation] = STEPS[quality];
  return [...new Array(count).fill(face), ...new Array(3).fill(rotation),
    ...new Array(3).fill(translation)];
}

/** @param {number} activity @returns {number} */
function contextOf(activity) {
  return ACTIVITY_LEVELS.filter((level) => level <= activity).length;
}

/** @param {Table} table @param {number} symbol @returns {[number, number]} */
function rangeOf(table, symbol) {
  return [table.starts[symbol], table.frequencies[symbol]];
}

/** @param {number} value @param {number} bits @returns {[number, number]} */
function uniform(value, bits) {
  return [value * (TOTAL >> bits), TOTAL >> bits];
}

/** @param {number} value @returns {number} */
function bitLength(value) {
  return value ? 32 - Math.clz32(value) : 0;
}

/** @param {number} value @param {number} limit @returns {number} */
function clamp(value, limit) {
  return Math.min(Math.max(value, -limit), limit);
}

/** @param {number} value @returns {number} */
function roundHalfEven(value) {
  const rounded = Math.round(value);
  return Math.abs(value % 1) === 0.5 && rounded % 2 ? rounded - 1 : rounded;
}
