/** What a camera says of a face, made calm and one's own: `sources/live_face.py` and
 * `calibration.py`. A face is 52 shapes, the head's turn (axis times angle) and its place. */

import { clamp } from "./space.js";

const [SHAPES, BLINKS, CLOSED] = [52, [0, 7], 0.5];
/** Shapes of the eyes come in two sevens: the lid, four of gaze, and two more. @param {number} k */
const isGaze = (k) => k < 14 && k % 7 > 0 && k % 7 < 5;
/** Least cutoff of a low-pass, hertz, and what a unit a second adds to it: lids and gaze, mouth,
 * the rest, turn, place. @param {number} k */
const cutoffOf = (k) => (k > 54 ? [2, 20] : k > 51 ? [2, 4] : k < 14 && k % 7 < 5 ? [12, 20]
  : k === 51 || (k > 13 && k < 41) ? [5, 6] : [2.5, 3]);
const SPEED_HZ = 1;
const [FOLLOWS_S, REACH_M] = [8, [0.15, 0.1, 0.15]];
const [MAX_NEUTRAL, MAX_OPEN] = [0.6, 0.8];
/** A gap that is a new beginning; how long the face at rest is watched. */
const [HOLD_S, REST_S] = [0.2, 1.5];

/** The share of a new value that a low-pass takes. @param {number} hz @param {number} stepS */
const share = (hz, stepS) => 1 - 1 / (1 + 2 * Math.PI * hz * stepS);

/** The face as a perfect tracker would see it. @param {ArrayLike<number>} face
 * @param {ArrayLike<number>} neutral What is seen of the same person at rest. */
export function calibrated(face, neutral) {
  return Float64Array.from(face, (value, k) => {
    if (k >= SHAPES || isGaze(k)) return value;
    if (BLINKS.includes(k)) return clamp((value - neutral[k]) / (1 - neutral[k]), 0, 1);
    const rest = clamp(neutral[k], 0, MAX_NEUTRAL);
    return rest > 0 ? Math.max((value - rest) / (1 - rest), 0) : value;
  });
}

/** One person before one camera. */
export class Tracking {
  /** @type {Float64Array | null} */
  smoothed = null;
  speed = new Float64Array(SHAPES + 6);
  gaze = new Float64Array(SHAPES);
  /** @type {number[]} */
  seat = [];
  atS = -Infinity;
  /** The faces at rest, from the first one on.
   * @type {{beginS: number, faces: ArrayLike<number>[]}} */
  rest = { beginS: NaN, faces: [] };
  neutral = new Float64Array(SHAPES);

  /** There is no face. */
  lose() {
    this.smoothed = null;
    return null;
  }

  /** A face that was seen; the one to show. @param {ArrayLike<number>} face @param {number} atS */
  push(face, atS) {
    if (atS - this.atS > HOLD_S) this.lose();
    const stepS = clamp(atS - this.atS, 1e-3, HOLD_S);
    this.atS = atS;
    this.learn(face, atS);
    const pose = calibrated(face, this.neutral);
    if (!this.smoothed) this.seat = [...pose.subarray(SHAPES + 3)];
    this.seat.forEach((place, axis) => {
      const to = pose[SHAPES + 3 + axis];
      this.seat[axis] = place + Math.min(stepS / FOLLOWS_S, 1) * (to - place);
      pose[SHAPES + 3 + axis] = clamp(to - this.seat[axis], -REACH_M[axis], REACH_M[axis]);
    });
    return this.smooth(pose, stepS);
  }

  /** @param {ArrayLike<number>} face @param {number} atS */
  learn(face, atS) {
    const { rest } = this;
    if (!rest.faces.length) rest.beginS = atS;
    if (!(atS - rest.beginS < REST_S)) return;
    rest.faces.push(face);
    this.neutral = this.neutral.map((_, k) => {
      const sorted = rest.faces.map((each) => each[k]).sort((a, b) => a - b);
      const median = (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;
      return BLINKS.includes(k) ? Math.min(median, MAX_OPEN) : median;
    });
  }

  /** @param {Float64Array} pose @param {number} stepS */
  smooth(pose, stepS) {
    const before = this.smoothed;
    if (!before) this.speed.fill(0);
    this.smoothed = pose.map((value, k) => {
      if (!before) return value;
      const [leastHz, perSpeed] = cutoffOf(k);
      this.speed[k] += share(SPEED_HZ, stepS) * ((value - before[k]) / stepS - this.speed[k]);
      return before[k] + share(leastHz + perSpeed * Math.abs(this.speed[k]), stepS)
        * (value - before[k]);
    });
    const shown = Float32Array.from(this.smoothed);
    // Trackers guess the gaze behind closed lids.
    const isClosed = before && BLINKS.every((k) => shown[k] > CLOSED);
    this.gaze.forEach((kept, k) => {
      if (isClosed && isGaze(k)) shown[k] = kept;
      else this.gaze[k] = shown[k];
    });
    return shown;
  }
}
