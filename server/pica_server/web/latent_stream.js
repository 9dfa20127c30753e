/**
 * The latent stream: a few bytes to a face, and back. Every frame is decoded alone, in whole
 * numbers below 2^53, which floats hold exactly. The format is that of docs/wire.md;
 * `pica_core.codec` is the Python side.
 */

export const NUM_LATENT = 256;
export const NUM_ARKIT = 52;
const [TOTAL_BITS, TOTAL] = [14, 1 << 14];
const [FULL_RANGE, LEAST_RANGE] = [2 ** 48, 2 ** 40];
const MAX_PAYLOAD_BYTES = 1280;
const [HAS_FACE, HAS_POSE, IS_STILL, HAS_REST] = [1, 2, 4, 8];
const [SHAPE_UNIT, POSE_UNIT, REST_UNIT] = [2 ** -12, 2 ** -14, 2 ** -10];
/** Coefficients of a frame without what is left of a latent. */
const NUM_DRIVEN = NUM_ARKIT + 6;
const MAX_SHAPE = 2;
const MAX_COEFFICIENT = 1 << 16;
/** Longer latents are shortened to this. */
const MAX_LENGTH = 128;
const LEAKY_SLOPE = 0.2;
/** By quality: 16ths of the usual steps. */
const FINENESS = [36, 28, 21, 16, 12, 9, 6, 4];
const DEFAULT_QUALITY = 3;
/** A bit less is worth so much more squared error of a shape, in squared steps. */
const BIT_PRICE = 0.15;
/** Of the 52 shapes, the rotation, the translation, and what is left of a latent. */
const USUAL_STEPS = [
  62, 70, 109, 97, 111, 200, 177, 62, 70, 97, 109, 111, 200, 177, 58, 90, 83, 15, 24, 49, 76, 55,
  56, 68, 68, 185, 185, 165, 165, 156, 156, 67, 106, 53, 93, 162, 162, 130, 130, 84, 84, 120, 120,
  78, 68, 68, 62, 165, 165, 66, 66, 200,
  12, 12, 12, 2, 2, 2, ...Array(NUM_LATENT).fill(32),
];
const TABLES = [
  4, 6, 4, 4, 5, 5, 5, 0, 0, 2, 2, 0, 0, 0, 3, 2, 2, 7, 4, 6, 4, 3, 3, 6, 1, 5, 0, 5, 0, 5, 0, 4, 5,
  6, 5, 5, 0, 5, 1, 6, 1, 4, 1, 6, 6, 1, 3, 5, 1, 6, 1, 2,
  8, 8, 8, 9, 9, 9, ...Array(NUM_LATENT).fill(4),
];
/** Which coefficient predicts each, where one does. @type {Record<number, number>} */
const FIRST = {
  7: 0, 8: 1, 9: 3, 10: 2, 11: 4, 12: 5, 13: 6, 24: 23, 26: 25, 28: 27, 30: 29, 36: 35, 38: 37,
  40: 39, 42: 41, 45: 44, 48: 47, 50: 49,
};
const LENGTH_TABLES = [
  [15635, 410, 147, 94, 53, 22, 14, 1, 1, 1, 1, 1, 1, 1, 1, 1],
  [14973, 910, 269, 100, 74, 41, 8, 1, 1, 1, 1, 1, 1, 1, 1, 1],
  [9436, 2034, 3070, 1322, 287, 181, 37, 8, 2, 1, 1, 1, 1, 1, 1, 1],
  [9137, 1576, 1949, 2987, 382, 201, 121, 21, 3, 1, 1, 1, 1, 1, 1, 1],
  [6256, 1483, 2392, 2688, 2043, 1146, 309, 56, 4, 1, 1, 1, 1, 1, 1, 1],
  [5180, 3034, 3611, 2850, 1357, 294, 35, 13, 3, 1, 1, 1, 1, 1, 1, 1],
  [3830, 1379, 2502, 3422, 2949, 1715, 561, 16, 3, 1, 1, 1, 1, 1, 1, 1],
  [2865, 445, 596, 863, 1232, 2520, 3340, 3506, 998, 13, 1, 1, 1, 1, 1, 1],
  [4599, 1900, 1350, 1850, 2450, 2150, 1450, 540, 60, 20, 8, 2, 2, 1, 1, 1],
  [4199, 2400, 1950, 2400, 2500, 1800, 860, 220, 30, 12, 6, 2, 2, 1, 1, 1],
].map(tableOf);
const QUALITY_TABLE = tableOf([192, 192, 192, 11426, 3810, 191, 191, 190]);
const HEADER_TABLE = tableOf([1, 4600, 2, 11440, 1, 59, 1, 270, 1, 1, 1, 3, 1, 1, 1, 1]);

/** What cannot be read as a frame. */
export class LatentError extends Error {}

/** Where the share of each symbol begins, and where that of the last ends.
 * @param {number[]} frequencies */
function tableOf(frequencies) {
  const starts = [0];
  frequencies.forEach((frequency, symbol) => starts.push(starts[symbol] + frequency));
  return starts;
}

/** The share of a symbol: where it begins, and its size.
 * @type {(table: number[], symbol: number) => [number, number]} */
const rangeOf = (table, symbol) => [table[symbol], table[symbol + 1] - table[symbol]];

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
  /** @param {[number, number]} range */
  const take = ([start, frequency]) => {
    code -= start * width;
    width *= frequency;
    while (width < LEAST_RANGE) {
      code = code * 256 + (payload[next++] ?? 0);
      width *= 256;
    }
  };
  return {
    /** @param {number[]} table */
    symbol(table) {
      const found = slot();
      const symbol = table.findLastIndex((start) => start <= found);
      take(rangeOf(table, symbol));
      return symbol;
    },
    /** @param {number} bits */
    uniform(bits) {
      const value = slot() >> (TOTAL_BITS - bits);
      take(uniform(value, bits));
      return value;
    },
    finish() {
      if (payload.length > next) throw new LatentError("payload has bytes too many");
    },
  };
}

/** The network of an avatar that makes latents of the 52 shapes.
 * @param {Pick<Avatar, "floats">} avatar @returns {(arkit: Float32Array) => Float32Array} */
export function openEncoder(avatar) {
  const layers = [[NUM_ARKIT, 160], [160, 160], [160, NUM_LATENT]].map(([ins, outs], index) => [
    avatar.floats(`encoder.${index}.weight`, ins * outs),
    avatar.floats(`encoder.${index}.bias`, outs),
  ]);
  return (arkit) => layers.reduce((values, [weight, bias], index) => {
    const inputs = index ? values.map((value) => Math.max(value, LEAKY_SLOPE * value)) : values;
    return bias.map((sum, row) =>
      inputs.reduce((all, value, i) => all + value * weight[row * inputs.length + i], sum));
  }, arkit);
}

/** Read the coefficients of one frame; throws a `LatentError` if no encoder wrote it.
 * @param {Uint8Array} payload */
export function decodeFrame(payload) {
  const reader = openPayload(payload);
  const steps = stepsOf(reader.symbol(QUALITY_TABLE));
  const header = reader.symbol(HEADER_TABLE);
  /** @type {number[]} */
  const numbers = [];
  TABLES.slice(0, header & HAS_REST ? TABLES.length : NUM_DRIVEN).forEach((table, place) => {
    const start = numbers[FIRST[place]] ?? 0;
    const isCoded = place >= NUM_DRIVEN || header & (place < NUM_ARKIT ? HAS_FACE : HAS_POSE);
    const length = isCoded ? reader.symbol(LENGTH_TABLES[table]) : 0;
    if (!length) return numbers.push(start);
    const sign = isSigned(place) && reader.uniform(1) ? -1 : 1;
    return numbers.push(start + sign * (2 ** (length - 1) + reader.uniform(length - 1)));
  });
  reader.finish();
  const coefficients = numbers.map((number, place) => number * steps[place]);
  if (Math.min(...coefficients.slice(0, NUM_ARKIT)) < 0) throw new LatentError("negative shape");
  if (coefficients.some((value) => Math.abs(value) > MAX_COEFFICIENT)) {
    throw new LatentError(`a coefficient is beyond the limit of ${MAX_COEFFICIENT}`);
  }
  return { coefficients, isStill: Boolean(header & IS_STILL) };
}

/** @param {ReturnType<typeof openEncoder>} encode @param {Uint8Array} payload
 * @returns {Sample} */
export function decodeFace(encode, payload) {
  const { coefficients, isStill } = decodeFrame(payload);
  const shapes = coefficients.slice(0, NUM_ARKIT).map((value) => value * SHAPE_UNIT);
  const rest = coefficients.slice(NUM_DRIVEN);
  const latent = encode(Float32Array.from(shapes))
    .map((value, place) => value + (rest[place] ?? 0) * REST_UNIT);
  const length = Math.sqrt(latent.reduce((sum, value) => sum + value ** 2, 0));
  const shorter = Math.min(MAX_LENGTH / length, 1);
  const values = new Float32Array(NUM_LATENT + 6);
  values.set(shorter < 1 ? latent.map((value) => value * shorter) : latent);
  const pose = coefficients.slice(NUM_ARKIT, NUM_DRIVEN).map((value) => value * POSE_UNIT);
  values.set(pose, NUM_LATENT);
  return { values, isStill };
}

/** Write a face, 52 shapes and 6 values of the pose, as one frame, at the quality that senders
 * use. @param {Float32Array} values */
export function encodeFace(values) {
  const steps = stepsOf(DEFAULT_QUALITY);
  /** @type {number[]} */
  const numbers = [];
  values.forEach((value, place) =>
    numbers.push(quantised(coefficientOf(value, place), steps[place], place, numbers)));
  const isSome = [numbers.slice(0, NUM_ARKIT), numbers.slice(NUM_ARKIT)].map((part) =>
    part.some(Boolean));
  const header = (isSome[0] ? HAS_FACE : 0) | (isSome[1] ? HAS_POSE : 0);
  const ranges = [rangeOf(QUALITY_TABLE, DEFAULT_QUALITY), rangeOf(HEADER_TABLE, header)];
  numbers.forEach((number, place) => {
    if (!isSome[place < NUM_ARKIT ? 0 : 1]) return;
    const ahead = number - (numbers[FIRST[place]] ?? 0);
    const length = bitLength(Math.abs(ahead));
    ranges.push(rangeOf(LENGTH_TABLES[TABLES[place]], length));
    if (length && isSigned(place)) ranges.push(uniform(ahead < 0 ? 1 : 0, 1));
    if (length) ranges.push(uniform(Math.abs(ahead) - 2 ** (length - 1), length - 1));
  });
  return writeSymbols(ranges);
}

/** @type {(value: number, place: number) => number} */
function coefficientOf(value, place) {
  const isShape = place < NUM_ARKIT;
  const limit = isShape ? MAX_SHAPE : place < NUM_ARKIT + 3 ? Math.PI : 1;
  const limited = Math.min(Math.max(value, isShape ? 0 : -limit), limit);
  return Math.round(limited / (isShape ? SHAPE_UNIT : POSE_UNIT));
}

/**
 * A coefficient in steps: the nearest, or for shapes one nearer to what predicts it where the bits
 * are worth the error.
 * @type {(value: number, step: number, place: number, before: number[]) => number}
 */
function quantised(value, step, place, before) {
  const nearest = Math.floor((2 * value + step) / (2 * step));
  const ahead = nearest - (before[FIRST[place]] ?? 0);
  if (!ahead || place >= NUM_ARKIT) return nearest;
  const towards = Math.sign(ahead);
  const grown = 1 + 2 * towards * (value / step - nearest);
  const saved = bitsOf(place, ahead) - bitsOf(place, ahead - towards);
  return BIT_PRICE * saved > grown ? nearest - towards : nearest;
}

/** What a coefficient costs that is so far ahead of what predicts it.
 * @type {(place: number, ahead: number) => number} */
function bitsOf(place, ahead) {
  const length = bitLength(Math.abs(ahead));
  const uncoded = length ? length - 1 + (isSigned(place) ? 1 : 0) : 0;
  return uncoded - Math.log2(rangeOf(LENGTH_TABLES[TABLES[place]], length)[1] / TOTAL);
}

/** @type {(place: number) => boolean} */
const isSigned = (place) => place >= NUM_ARKIT || place in FIRST;
/** @param {number} quality */
const stepsOf = (quality) =>
  USUAL_STEPS.map((step) => Math.max(Math.floor((step * FINENESS[quality]) / 16), 1));

/** @param {[number, number][]} ranges */
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

/** @type {(value: number, bits: number) => [number, number]} */
const uniform = (value, bits) => [value * (TOTAL >> bits), TOTAL >> bits];
/** @param {number} value */
const bitLength = (value) => 32 - Math.clz32(value);
