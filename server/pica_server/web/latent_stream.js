/**
 * The latent stream: a few bytes to a face, and back. Every frame is decoded alone, in whole
 * numbers below 2^53, which floats hold exactly; so all receivers see the same face. The format is
 * that of docs/wire.md; `pica_core.codec` is the Python side.
 */

/** @typedef {ArrayLike<number>} Numbers */
/**
 * A face at one moment. Its 262 values: the latent (8 rows, 8 columns, 4 channels), the rotation
 * from head to seat (a rotation vector, radians) and the translation (metres).
 * @typedef {{values: Float32Array, isStill: boolean}} Sample Still: nothing changes until the next
 * one.
 */
/** @typedef {{frequencies: number[], starts: number[], symbols: Uint8Array}} Table */
/** @typedef {[start: number, frequency: number]} Range */

export const NUM_LATENT = 256;
export const NUM_VALUES = NUM_LATENT + 6;
const TOTAL_BITS = 14;
const TOTAL = 1 << TOTAL_BITS;
const FULL_RANGE = 2 ** 48;
const LEAST_RANGE = 2 ** 40;
const MAX_PAYLOAD_BYTES = 512;
const ESCAPE = 20;
const ACTIVITY_LEVELS = [1, 4, 9, 20, 40];
const ACTIVITY_WINDOW = 16;
const MAX_REST_BITS = 13;
const [HAS_LATENT, HAS_POSE, IS_STILL] = [1, 2, 4];
const POSE_UNIT = 2 ** -14;
const LATENT_UNIT = 2 ** -12;
const MAX_LATENT = 1 << 20;
const MAX_COEFFICIENT = 1 << 16;
const NUM_TABLES = 121;
const MAX_SHIFT = 24;
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

/** @type {(frequencies: number[]) => Table} */
function tableOf(frequencies) {
  const starts =
    frequencies.map((_, symbol) => frequencies.slice(0, symbol).reduce((a, b) => a + b, 0));
  const symbols = new Uint8Array(TOTAL);
  starts.forEach((start, symbol) => symbols.fill(symbol, start, start + frequencies[symbol]));
  return { frequencies, starts, symbols };
}

const QUALITY_TABLE = tableOf([192, 192, 192, 11426, 3810, 191, 191, 190]);
const HEADER_TABLE = tableOf([1, 2886, 2, 13169, 1, 59, 1, 265]);
const ROTATION_TABLE = tableOf(
  [4599, 1900, 1350, 1850, 2450, 2150, 1450, 540, 60, 20, 8, 2, 2, 1, 1, 1]);
const TRANSLATION_TABLE = tableOf(
  [4199, 2400, 1950, 2400, 2500, 1800, 860, 220, 30, 12, 6, 2, 2, 1, 1, 1]);
const POSE_TABLES = [ROTATION_TABLE, TRANSLATION_TABLE].flatMap((table) => [table, table, table]);
/** @type {Table[]} */
const coefficientTables = [];

/** @param {number} index 11 a + b. @returns {Table} */
export function coefficientTable(index) {
  if (!coefficientTables[index]) {
    const zero = 1 + 3 * Math.floor(index / 11);
    const ratio = 1 + 3 * (index % 11);
    const weights = [2 ** 30];
    while (weights.length < ESCAPE)
      weights.push(Math.floor((weights[weights.length - 1] * ratio) / 32));
    weights[ESCAPE - 1] = Math.floor((weights[ESCAPE - 1] * 32) / (32 - ratio));
    const sum = weights.reduce((a, b) => a + b);
    const spare = (TOTAL - 2 * ESCAPE - 1) * (32 - zero);
    // Products reach 2^49 and the divisor 2^41: the quotient of floats rounds to no other integer.
    const sides = weights.map((weight) => 1 + Math.floor((spare * weight) / (64 * sum)));
    const middle = TOTAL - 2 * sides.reduce((a, b) => a + b);
    coefficientTables[index] = tableOf([middle, ...sides.flatMap((side) => [side, side])]);
  }
  return coefficientTables[index];
}

/** What a frame's coefficients mean for one avatar, and how likely they are. */
export class StreamProfile {
  /**
   * Throws an `Error` if the numbers are none.
   * @param {(name: string) => Numbers} tensor Gives a tensor of the avatar file by its name.
   */
  constructor(tensor) {
    const indices = Array.from(tensor("stream.table_index"));
    const [shift] = Array.from(tensor("stream.synthesis_shift"));
    if (indices.some((index) => index >= NUM_TABLES) || !(shift >= 0 && shift <= MAX_SHIFT)) {
      throw new Error(
        `stream.table_index is beyond ${NUM_TABLES - 1}, or its shift beyond ${MAX_SHIFT}`);
    }
    this.count = indices.length / 6;
    this.tables = Array.from({ length: this.count }, (_, k) =>
      indices.slice(6 * k, 6 * k + 6).map(coefficientTable));
    this.scale = 2 ** shift;
    this.mean = tensor("stream.mean");
    this.analysis = tensor("stream.analysis");
    this.synthesis = tensor("stream.synthesis");
  }
}

/** The symbols of one payload, in order. @param {Uint8Array} payload */
function openPayload(payload) {
  if (payload.length > MAX_PAYLOAD_BYTES) {
    throw new LatentError(`payload of ${payload.length} bytes`);
  }
  if (payload.length && !payload[payload.length - 1]) {
    throw new LatentError("payload ends with a zero byte");
  }
  let [next, width, code] = [6, FULL_RANGE, 0];
  for (let at = 0; at < next; at++) code = code * 256 + (payload[at] ?? 0);
  const slot = () => {
    width = Math.floor(width / TOTAL);
    const found = Math.floor(code / width);
    if (found >= TOTAL) throw new LatentError("payload holds a code that no encoder writes");
    return found;
  };
  /** @type {(start: number, frequency: number) => void} */
  const take = (start, frequency) => {
    code -= start * width;
    width *= frequency;
    while (width < LEAST_RANGE) {
      code = code * 256 + (payload[next++] ?? 0);
      width *= 256;
    }
  };
  return {
    /** @param {Table} table */
    symbol(table) {
      const symbol = table.symbols[slot()];
      take(table.starts[symbol], table.frequencies[symbol]);
      return symbol;
    },
    /** @param {number} bits */
    uniform(bits) {
      const size = TOTAL >> bits;
      const value = Math.floor(slot() / size);
      take(value * size, size);
      return value;
    },
    finish() {
      if (payload.length > next) throw new LatentError("payload has bytes too many");
    },
  };
}

/**
 * Go through the coefficients of a face: each has the table that those before it choose.
 * @type {(profile: StreamProfile, visit: (table: Table, place: number) => number) => number[]}
 */
function eachCoefficient({ tables }, visit) {
  let activity = 0;
  /** @type {number[]} */
  const values = [];
  tables.forEach((contexts, place) => {
    const context = ACTIVITY_LEVELS.filter((level) => level <= activity).length;
    values.push(visit(contexts[context], place));
    activity += Math.abs(values[place]) - Math.abs(values[place - ACTIVITY_WINDOW] ?? 0);
  });
  return values;
}

/**
 * Read the coefficients of one frame; throws a `LatentError` if no encoder wrote it.
 * @param {StreamProfile} profile @param {Uint8Array} payload
 */
export function decodeFrame(profile, payload) {
  const reader = openPayload(payload);
  const steps = stepsOf(reader.symbol(QUALITY_TABLE), profile.count);
  const header = reader.symbol(HEADER_TABLE);
  const face = header & HAS_LATENT ? eachCoefficient(profile, (table) => {
    const symbol = reader.symbol(table);
    let magnitude = (symbol + 1) >> 1;
    if (magnitude >= ESCAPE) {
      const length = reader.uniform(4);
      if (length > MAX_REST_BITS) throw new LatentError(`a rest of ${length} bits`);
      magnitude += 2 ** length + reader.uniform(length) - 1;
    }
    return symbol & 1 ? magnitude : 0 - magnitude;
  }) : new Array(profile.count).fill(0);
  const pose = POSE_TABLES.map((table) => {
    const length = header & HAS_POSE ? reader.symbol(table) : 0;
    if (!length) return 0;
    const sign = reader.uniform(1) ? -1 : 1;
    return sign * (2 ** (length - 1) + reader.uniform(length - 1));
  });
  reader.finish();
  const coefficients = [...face, ...pose].map((value, i) => value * steps[i]);
  if (coefficients.some((value) => Math.abs(value) > MAX_COEFFICIENT)) {
    throw new LatentError(`a coefficient is beyond the limit of ${MAX_COEFFICIENT}`);
  }
  return { coefficients, isStill: Boolean(header & IS_STILL) };
}

/** @param {StreamProfile} profile @param {Uint8Array} payload @returns {Sample} */
export function decodeFace(profile, payload) {
  const { coefficients, isStill } = decodeFrame(profile, payload);
  const { mean, synthesis, scale, count } = profile;
  const values = new Float32Array(NUM_VALUES);
  let power = 0;
  for (let i = 0; i < NUM_LATENT; i++) {
    let sum = Math.floor(scale / 2);
    for (let k = 0; k < count; k++) sum += synthesis[k * NUM_LATENT + i] * coefficients[k];
    values[i] = clamp(Math.floor(sum / scale) + mean[i], MAX_LATENT) * LATENT_UNIT;
    power += values[i] ** 2;
  }
  const shorter = Math.min(MAX_LENGTH / Math.sqrt(power), 1);
  if (shorter < 1) values.forEach((value, i) => (values[i] = value * shorter));
  values.set(coefficients.slice(count).map((value) => value * POSE_UNIT), NUM_LATENT);
  return { values, isStill };
}

/** Write a face, 262 values, as one frame, at the quality that senders use.
 * @param {StreamProfile} profile @param {Float32Array} values */
export function encodeFace(profile, values) {
  const { mean, analysis, count } = profile;
  const steps = stepsOf(DEFAULT_QUALITY, count);
  const latent = Array.from(values.subarray(0, NUM_LATENT), (value, i) =>
    clamp(roundHalfEven(value / LATENT_UNIT), MAX_LATENT) - mean[i]);
  const exact = Array.from({ length: count }, (_, k) => {
    const sum = latent.reduce((all, value, i) => all + value * analysis[i * count + k], 2 ** 15);
    return clamp(Math.floor(sum / 2 ** 16), MAX_COEFFICIENT / 2);
  });
  const pose = Array.from(values.subarray(NUM_LATENT), (value, i) =>
    roundHalfEven(clamp(value, i < 3 ? Math.PI : 1) / POSE_UNIT));
  const rounded = [...exact, ...pose].map((value, i) =>
    Math.sign(value) * Math.floor((2 * Math.abs(value) + steps[i]) / (2 * steps[i])));
  const face = eachCoefficient(profile, (table, place) =>
    thrifty(table, rounded[place], Math.abs(exact[place]) / steps[0]));
  const turned = rounded.slice(count);
  const header = (face.some(Boolean) ? HAS_LATENT : 0) | (turned.some(Boolean) ? HAS_POSE : 0);
  const ranges = [rangeOf(QUALITY_TABLE, DEFAULT_QUALITY), rangeOf(HEADER_TABLE, header)];
  if (header & HAS_LATENT) {
    eachCoefficient(profile, (table, place) => {
      const magnitude = Math.abs(face[place]);
      ranges.push(rangeOf(table, 2 * Math.min(magnitude, ESCAPE) - (face[place] > 0 ? 1 : 0)));
      if (magnitude >= ESCAPE) {
        const rest = magnitude - ESCAPE + 1;
        const length = bitLength(rest) - 1;
        ranges.push(uniform(length, 4), uniform(rest - 2 ** length, length));
      }
      return face[place];
    });
  }
  turned.forEach((value, i) => {
    if (!(header & HAS_POSE)) return;
    const length = bitLength(Math.abs(value));
    ranges.push(rangeOf(POSE_TABLES[i], length));
    if (length) ranges.push(uniform(value < 0 ? 1 : 0, 1),
      uniform(Math.abs(value) - 2 ** (length - 1), length - 1));
  });
  return writeSymbols(ranges);
}

/** A coefficient in steps, one nearer to 0 where the bits are worth the error.
 * @param {Table} table @param {number} value @param {number} exact Without its sign. */
function thrifty({ frequencies }, value, exact) {
  const magnitude = Math.abs(value);
  const grown = 1 - 2 * (magnitude - exact);
  if (grown >= 1 || magnitude < 1 || magnitude >= ESCAPE) return value;
  const sign = value > 0 ? 1 : 0;
  const cheap = frequencies[magnitude > 1 ? 2 * (magnitude - 1) - sign : 0];
  const isWorth = BIT_PRICE * Math.log2(cheap / frequencies[2 * magnitude - sign]) > grown;
  return isWorth ? value - Math.sign(value) : value;
}

/** @param {Range[]} ranges */
function writeSymbols(ranges) {
  let [low, width, bits] = [0n, BigInt(FULL_RANGE), 48n];
  for (const [start, frequency] of ranges) {
    width >>= BigInt(TOTAL_BITS);
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
  for (let at = payload.length - 1; at >= 0; at--, code >>= 8n) payload[at] = Number(code & 255n);
  return payload;
}

/** @type {(quality: number, count: number) => number[]} */
function stepsOf(quality, count) {
  const [face, ...pose] = STEPS[quality];
  return [...new Array(count).fill(face), ...pose.flatMap((step) => [step, step, step])];
}

/** @type {(table: Table, symbol: number) => Range} */
const rangeOf = (table, symbol) => [table.starts[symbol], table.frequencies[symbol]];
/** @type {(value: number, bits: number) => Range} */
const uniform = (value, bits) => [value * (TOTAL >> bits), TOTAL >> bits];
/** @param {number} value */
const bitLength = (value) => (value ? 32 - Math.clz32(value) : 0);
/** @type {(value: number, limit: number) => number} */
const clamp = (value, limit) => Math.min(Math.max(value, -limit), limit);

/** @param {number} value */
function roundHalfEven(value) {
  const rounded = Math.round(value);
  return Math.abs(value % 1) === 0.5 && rounded % 2 ? rounded - 1 : rounded;
}
