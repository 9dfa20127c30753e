/**
 * A face without a camera: the voice moves its mouth, and it blinks. The mouth is the network of
 * `pica_client.voice.mouth`, whose weights the relay gives.
 *
 * @module
 */

import { seconds } from "./clock.js";
import { encodeFace, StreamProfile } from "./latent_stream.js";

/** @import { AvatarFile } from "./types.js" */
/** @typedef {Record<string, {shape: number[], values: Float32Array}>} Weights */

const RATE_HZ = 48_000;
const HOP = 480;
const WINDOW = 1200;
const NUM_BANDS = 40;
const HIGHEST_HZ = 7600;
const QUIETEST = 1e-7;
const LEVEL_DECAY = 0.9995;
const NUM_ARKIT = 52;
/** How much later than its sound a mouth is known. */
const DELAY_S = (4 * HOP + WINDOW / 2) / RATE_HZ;
/** Which of the 52 shapes each answer of the network is. */
const COLUMNS = [[17], [18], [19], [20], [31], [32], [35, 36], [29, 30], [23, 24], [37, 38], [39, 40]];
const BLINKS = [0, 7];
const BLINK_S = 0.22;
const LEAKY_SLOPE = 0.2;
const FRAME_MS = 33;
/** A mouth of which nothing more is heard comes to rest within it. */
const REST_S = 0.2;
/** Sequence numbers are multiples of these in turn, so that a quarter of them is a stream too. */
const MULTIPLES = [4, 1, 2, 1];

/** @param {URL} url @returns {Promise<Weights>} */
async function loadWeights(url) {
  /** @type {Record<string, {shape: number[], halfs: string}>} */
  const stored = await (await fetch(url)).json();
  return Object.fromEntries(Object.entries(stored).map(([name, { shape, halfs }]) => {
    const bytes = Uint8Array.from(atob(halfs), (char) => char.charCodeAt(0));
    return [name, { shape, values: Float32Array.from(new Uint16Array(bytes.buffer), half) }];
  }));
}

/** @param {number} bits Of a half float. @returns {number} */
function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  return sign * (exponent ? 2 ** (exponent - 25) * (1024 + fraction) : 2 ** -24 * fraction);
}

/** Values times a matrix, whose columns lie one after the other, plus a bias. @param {Weights} weights @param {string} name @param {Float32Array} values */
function linear(weights, name, values) {
  const { shape: [rows], values: matrix } = weights[name];
  return weights[`${name}_bias`].values.map((bias, column) => {
    let sum = bias;
    for (let row = 0; row < rows; row++) sum += values[row] * matrix[column * rows + row];
    return sum;
  });
}

/** @param {number} value @returns {number} */
function sigmoid(value) {
  return 1 / (1 + Math.exp(-value));
}

/** Log energies of mel bands, as sound comes in. */
class SpeechFeatures {
  constructor() {
    const numBins = Math.ceil((HIGHEST_HZ * WINDOW) / RATE_HZ);
    this.kept = new Float32Array(WINDOW);
    this.loudest = Math.log(QUIETEST);
    this.window = Float32Array.from({ length: WINDOW }, (_, n) =>
      0.5 - 0.5 * Math.cos((2 * Math.PI * n) / (WINDOW - 1)));
    this.waves = Array.from({ length: numBins }, (_, bin) => [Math.cos, Math.sin].map((wave) =>
      Float64Array.from({ length: WINDOW / 2 + 1 }, (_, n) => wave((2 * Math.PI * ((bin * n) % WINDOW)) / WINDOW))));
    const mel = (/** @type {number} */ hz) => 2595 * Math.log10(1 + hz / 700);
    const edges = Array.from({ length: NUM_BANDS + 2 }, (_, i) =>
      700 * (10 ** ((mel(80) + (i * (mel(HIGHEST_HZ) - mel(80))) / (NUM_BANDS + 1)) / 2595) - 1));
    this.filters = Array.from({ length: NUM_BANDS }, (_, band) => {
      const [low, middle, high] = edges.slice(band, band + 3);
      const weights = Float32Array.from({ length: numBins }, (_, bin) => {
        const hz = (bin * RATE_HZ) / WINDOW;
        return Math.max(Math.min((hz - low) / (middle - low), (high - hz) / (high - middle)), 0);
      });
      const sum = Math.max(weights.reduce((a, b) => a + b), 1e-9);
      return weights.map((weight) => weight / sum);
    });
  }

  /** @param {Float32Array} hop 480 samples. @returns {Float32Array} */
  push(hop) {
    this.kept.copyWithin(0, HOP);
    this.kept.set(hop, WINDOW - HOP);
    const sound = this.kept.map((value, n) => value * this.window[n]);
    // Waves of a whole number of turns are even or odd about the middle: half of the sums will do.
    const sums = new Float64Array(WINDOW / 2 + 1);
    const differences = new Float64Array(WINDOW / 2 + 1);
    [sums[0], sums[WINDOW / 2]] = [sound[0], sound[WINDOW / 2]];
    for (let n = 1; n < WINDOW / 2; n++) {
      sums[n] = sound[n] + sound[WINDOW - n];
      differences[n] = sound[n] - sound[WINDOW - n];
    }
    const power = this.waves.map(([even, odd]) => {
      let real = 0;
      let imaginary = 0;
      for (let n = 0; n <= WINDOW / 2; n++) {
        real += even[n] * sums[n];
        imaginary += odd[n] * differences[n];
      }
      return (real * real + imaginary * imaginary) / WINDOW;
    });
    const floor = Math.log(QUIETEST);
    const bands = Float32Array.from(this.filters, (filter) =>
      Math.log(power.reduce((sum, value, bin) => sum + value * filter[bin], QUIETEST)));
    this.loudest = Math.max(floor + (this.loudest - floor) * LEVEL_DECAY, ...bands);
    const reference = Math.max(this.loudest, floor + 6);
    return bands.map((value) => (value - reference) / 8);
  }
}

/** Hears one voice, and says how the mouth stands. */
export class Mouth {
  /** @param {Weights} weights */
  constructor(weights) {
    this.weights = weights;
    this.features = new SpeechFeatures();
    /** @type {Float32Array} */
    this.state = new Float32Array(weights.u.shape[0]);
    for (let i = 0; i < 100; i++) this.push(new Float32Array(HOP)); // it has listened to silence
  }

  /** The mouth `DELAY_S` before the end of a hop. @param {Float32Array} hop @returns {Float32Array} 52 shapes. */
  push(hop) {
    const { weights, state } = this;
    const hidden = linear(weights, "in", this.features.push(hop)).map((value) => Math.max(value, 0));
    const gate = linear(weights, "w", hidden);
    const past = linear(weights, "u", state);
    const size = state.length;
    this.state = state.map((value, i) => {
      const reset = sigmoid(gate[i] + past[i]);
      const keep = sigmoid(gate[size + i] + past[size + i]);
      return (1 - keep) * Math.tanh(gate[2 * size + i] + reset * past[2 * size + i]) + keep * value;
    });
    const answers = linear(weights, "out", this.state);
    const arkit = new Float32Array(NUM_ARKIT);
    COLUMNS.forEach((targets, column) => {
      for (const target of targets) arkit[target] = Math.min(Math.max(answers[column], 0), 1);
    });
    return arkit;
  }
}

/** The 52 shapes as an avatar's latent. @param {Pick<AvatarFile, "floats">} avatar @param {Float32Array} arkit @returns {Float32Array} */
export function encode(avatar, arkit) {
  return [0, 1, 2].reduce((values, index) => {
    const weight = avatar.floats(`encoder.${index}.weight`);
    const inputs = index ? values.map((value) => Math.max(value, LEAKY_SLOPE * value)) : values;
    return avatar.floats(`encoder.${index}.bias`).map((sum, row) =>
      inputs.reduce((all, value, i) => all + value * weight[row * inputs.length + i], sum));
  }, arkit);
}

/** Sends one's own face. */
export class OwnFace {
  /**
   * @param {AvatarFile} avatar
   * @param {Mouth} mouth
   * @param {(payload: Uint8Array, capturedUs: number, multiple: number) => void} send
   */
  constructor(avatar, mouth, send) {
    this.profile = new StreamProfile((name) => avatar.integers(name));
    const names = [0, 1, 2].flatMap((index) => [`encoder.${index}.weight`, `encoder.${index}.bias`]);
    const tensors = new Map(names.map((name) => [name, avatar.floats(name)]));
    this.encoder = { floats: (/** @type {string} */ name) => /** @type {Float32Array} */ (tensors.get(name)) };
    this.mouth = mouth;
    this.send = send;
    /** @type {Float32Array} */
    this.shapes = new Float32Array(NUM_ARKIT);
    /** When the shapes were seen, by our clock. */
    this.heardS = -Infinity;
    this.capturedS = -Infinity;
    this.blinkS = seconds() + 2;
    this.phase = 0;
    this.timer = setInterval(() => this.frame(seconds()), FRAME_MS);
  }

  /** Take sound that was heard. @param {Float32Array} pcm 20 ms. @param {number} endS When its last sample was heard. */
  hear(pcm, endS) {
    this.mouth.push(pcm.subarray(0, HOP));
    this.shapes = this.mouth.push(pcm.subarray(HOP));
    this.heardS = endS - DELAY_S;
  }

  /** @param {number} now */
  frame(now) {
    const idleS = now - DELAY_S;
    const lateS = idleS - this.heardS;
    const isHeard = lateS < REST_S;
    const capturedS = Math.max(isHeard ? this.heardS : idleS - REST_S, this.capturedS);
    if (capturedS === this.capturedS) return;
    this.capturedS = capturedS;
    const arkit = isHeard ? this.shapes.slice() : new Float32Array(NUM_ARKIT);
    if (now > this.blinkS + BLINK_S) this.blinkS = now + 1.5 + 4 * Math.random();
    for (const shape of BLINKS) {
      arkit[shape] = Math.max(1 - Math.abs((2 * (now - this.blinkS)) / BLINK_S - 1), 0);
    }
    const rotation = [0.03 * Math.sin(now / 2.3), 0.05 * Math.sin(now / 3.7), 0.01 * Math.sin(now / 5.1)];
    const face = Float32Array.from([...encode(this.encoder, arkit), ...rotation, 0, 0, 0]);
    this.send(encodeFace(this.profile, face), Math.round(capturedS * 1e6), MULTIPLES[this.phase++ % 4]);
  }

  close() {
    clearInterval(this.timer);
  }
}

/** @param {URL | string} base The folder of the modules. @returns {Promise<Mouth>} */
export async function openMouth(base) {
  return new Mouth(await loadWeights(new URL("mouth.json", base)));
}
