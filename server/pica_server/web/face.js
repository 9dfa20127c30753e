/**
 * One's own face: a camera's, or the voice moves its mouth, and it blinks. The mouth is the network
 * of `pica_client.voice.mouth`, whose weights the relay gives.
 */

import { seconds } from "./clock.js";
import { NUM_ARKIT, encodeFace } from "./latent_stream.js";
import { clamp, sigmoid } from "./space.js";
import { fromBase64 } from "./wire.js";

/** @typedef {Record<string, {shape: number[], values: ArrayLike<number>}>} Weights */

const RATE_HZ = 48_000;
const [HOP, WINDOW] = [480, 1200];
const [NUM_BANDS, LOWEST_HZ, HIGHEST_HZ] = [40, 80, 7600];
const QUIETEST = 1e-7;
const LEVEL_DECAY = 0.9995;
/** How much later than its sound a mouth is known. */
const DELAY_S = (4 * HOP + WINDOW / 2) / RATE_HZ;
/** Which of the 52 shapes each answer of the network is. */
const COLUMNS =
  [[17], [18], [19], [20], [31], [32], [35, 36], [29, 30], [23, 24], [37, 38], [39, 40]];
const BLINKS = [0, 7];
const BLINK_S = 0.22;
/** A mouth of which nothing more is heard comes to rest within it. */
const REST_S = 0.2;
/** How long a face that a camera sees no more stands still, and how long one takes to another. */
const [HOLD_S, EASE_S] = [0.2, 0.4];
/** Sequence numbers are multiples of these in turn, so that a quarter of them is a stream too. */
const MULTIPLES = [4, 1, 2, 1];

/** Values times a matrix, whose columns lie one after the other, plus a bias.
 * @param {Weights} weights @param {string} name @param {ArrayLike<number>} values */
function linear(weights, name, values) {
  const { shape: [rows], values: matrix } = weights[name];
  return Float32Array.from(weights[`${name}_bias`].values, (bias, column) => {
    let sum = bias;
    for (let row = 0; row < rows; row++) sum += values[row] * matrix[column * rows + row];
    return sum;
  });
}

/** @template T @param {number} count @param {(index: number) => T} make */
const each = (count, make) => Array.from({ length: count }, (_, index) => make(index));

/** Log energies of mel bands, as sound comes in. */
class SpeechFeatures {
  kept = new Float32Array(WINDOW);
  loudest = Math.log(QUIETEST);

  constructor() {
    const numBins = Math.ceil((HIGHEST_HZ * WINDOW) / RATE_HZ);
    const window = each(WINDOW, (n) => 0.5 - 0.5 * Math.cos((2 * Math.PI * n) / (WINDOW - 1)));
    this.waves = each(numBins, (bin) => [Math.cos, Math.sin].map((wave) => Float64Array.from(window,
        (weight, n) => weight * wave((2 * Math.PI * ((bin * n) % WINDOW)) / WINDOW))));
    const [low, high] = [LOWEST_HZ, HIGHEST_HZ].map((hz) => 2595 * Math.log10(1 + hz / 700));
    const edges = each(NUM_BANDS + 2,
      (i) => 700 * (10 ** ((low + (i * (high - low)) / (NUM_BANDS + 1)) / 2595) - 1));
    this.filters = each(NUM_BANDS, (band) => {
      const [from, middle, to] = edges.slice(band, band + 3);
      const weights = each(numBins, (bin) => {
        const hz = (bin * RATE_HZ) / WINDOW;
        return Math.max(Math.min((hz - from) / (middle - from), (to - hz) / (to - middle)), 0);
      });
      const sum = Math.max(weights.reduce((a, b) => a + b), 1e-9);
      return weights.map((weight) => weight / sum);
    });
  }

  /** @param {Float32Array} hop 480 samples. */
  push(hop) {
    this.kept.copyWithin(0, HOP);
    this.kept.set(hop, WINDOW - HOP);
    const power = this.waves.map(([even, odd]) => {
      let [real, imaginary] = [0, 0];
      for (let n = 0; n < WINDOW; n++) {
        real += even[n] * this.kept[n];
        imaginary += odd[n] * this.kept[n];
      }
      return (real * real + imaginary * imaginary) / WINDOW;
    });
    const floor = Math.log(QUIETEST);
    const bands = this.filters.map((filter) =>
      Math.log(power.reduce((sum, value, bin) => sum + value * filter[bin], QUIETEST)));
    this.loudest = Math.max(floor + (this.loudest - floor) * LEVEL_DECAY, ...bands);
    const reference = Math.max(this.loudest, floor + 6);
    return bands.map((value) => (value - reference) / 8);
  }
}

/** Hears one voice, and says how the mouth stands. */
export class Mouth {
  features = new SpeechFeatures();

  /** @param {Weights} weights */
  constructor(weights) {
    this.weights = weights;
    this.state = new Float32Array(weights.u.shape[0]);
    for (let i = 0; i < 100; i++) this.push(new Float32Array(HOP)); // it has listened to silence
  }

  /** The mouth `DELAY_S` before the end of a hop: 52 shapes. @param {Float32Array} hop */
  push(hop) {
    const { weights, state } = this;
    const hidden = linear(weights, "in", this.features.push(hop))
      .map((value) => Math.max(value, 0));
    const [gate, past] = [linear(weights, "w", hidden), linear(weights, "u", state)];
    const size = state.length;
    this.state = state.map((value, i) => {
      const reset = sigmoid(gate[i] + past[i]);
      const keep = sigmoid(gate[size + i] + past[size + i]);
      return (1 - keep) * Math.tanh(gate[2 * size + i] + reset * past[2 * size + i]) + keep * value;
    });
    const answers = linear(weights, "out", this.state);
    const arkit = new Float32Array(NUM_ARKIT);
    COLUMNS.forEach((targets, column) => {
      for (const target of targets) arkit[target] = clamp(answers[column], 0, 1);
    });
    return arkit;
  }
}

/** Sends one's own face. */
export class OwnFace {
  shapes = new Float32Array(NUM_ARKIT);
  /** What was sent last, and what before it came from elsewhere. */
  shown = new Float32Array(NUM_ARKIT + 6);
  left = this.shown;
  leftS = -Infinity;
  /** When a camera began to see none. */
  lostS = -Infinity;
  isSeen = false;
  /** When the shapes were seen, by our clock. */
  heardS = -Infinity;
  capturedS = -Infinity;
  blinkS = seconds() + 2;
  phase = 0;
  pulse = new Worker(new URL("pulse.js", import.meta.url));

  /** @param {Mouth} mouth @param {SendFace} send */
  constructor(mouth, send) {
    this.mouth = mouth;
    this.send = send;
    this.pulse.onmessage = () => this.frame(seconds());
  }

  /** @param {SendFace} send */
  static async open(send) {
    /** @type {Record<string, {shape: number[], halfs: string}>} */
    const stored = await (await fetch(new URL("mouth.json", import.meta.url))).json();
    const weights = Object.entries(stored).map(([name, { shape, halfs }]) =>
      [name, { shape, values: new Float16Array(fromBase64(halfs).buffer) }]);
    return new OwnFace(new Mouth(Object.fromEntries(weights)), send);
  }

  close() {
    this.pulse.terminate();
  }

  /** Take sound that was heard. @param {Float32Array} pcm 20 ms. @param {number} endS When its last
   * sample was heard. */
  hear(pcm, endS) {
    this.mouth.push(pcm.subarray(0, HOP));
    this.shapes = this.mouth.push(pcm.subarray(HOP));
    this.heardS = endS - DELAY_S;
  }

  /** Take a face that a camera saw: 52 shapes, the head's turn and place; null: there is none.
   * @param {Float32Array | null} face @param {number} capturedS */
  see(face, capturedS) {
    this.lostS = face ? Infinity : Math.min(this.lostS, capturedS);
    if (face) this.show(face, capturedS, true);
  }

  /** @param {number} now */
  frame(now) {
    if (now < this.lostS + HOLD_S) return;
    const idleS = now - DELAY_S;
    const isHeard = idleS - this.heardS < REST_S;
    const capturedS = isHeard ? this.heardS : idleS - REST_S;
    if (capturedS <= this.capturedS) return;
    const face = new Float32Array(NUM_ARKIT + 6);
    if (isHeard) face.set(this.shapes);
    if (now > this.blinkS + BLINK_S) this.blinkS = now + 1.5 + 4 * Math.random();
    for (const shape of BLINKS) {
      face[shape] = Math.max(1 - Math.abs((2 * (now - this.blinkS)) / BLINK_S - 1), 0);
    }
    face.set([0.03 * Math.sin(now / 2.3), 0.05 * Math.sin(now / 3.7), 0.01 * Math.sin(now / 5.1)],
      NUM_ARKIT);
    this.show(face, capturedS, false);
  }

  /** Send a face, softly where it comes from elsewhere than the last one.
   * @param {Float32Array} face @param {number} capturedS @param {boolean} isSeen */
  show(face, capturedS, isSeen) {
    if (capturedS <= this.capturedS) return;
    this.capturedS = capturedS;
    if (isSeen !== this.isSeen) [this.left, this.leftS] = [this.shown, capturedS];
    this.isSeen = isSeen;
    const way = clamp((capturedS - this.leftS) / EASE_S, 0, 1);
    const { left } = this;
    this.shown = face.map((value, k) => left[k] + way * way * (3 - 2 * way) * (value - left[k]));
    this.send(encodeFace(this.shown), Math.round(capturedS * 1e6), MULTIPLES[this.phase++ % 4]);
  }
}
