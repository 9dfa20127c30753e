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
/** A gap that is a new beginning. */
const HOLD_S = 0.2;
/** After the first face: until when one at rest is watched; from when until when closed eyes. */
const [REST_S, CLOSED_S, KNOWN_S] = [1.5, 2.5, 4.5];
const LEAST_LID_RANGE = 0.2;

/** The share of a new value that a low-pass takes. @param {number} hz @param {number} stepS */
const share = (hz, stepS) => 1 - 1 / (1 + 2 * Math.PI * hz * stepS);

/** What is seen of each shape. @param {ArrayLike<number>[]} faces */
const medians = (faces) => Float64Array.from({ length: SHAPES }, (_, k) => {
  const sorted = faces.map((face) => face[k]).sort((a, b) => a - b);
  return (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;
});

/** The face as a perfect tracker would see it; what is seen of it at rest and with closed eyes.
 * @type {(face: ArrayLike<number>, ...levels: Float64Array[]) => Float64Array} */
function calibrated(face, neutral, closed) {
  return Float64Array.from(face, (value, k) => {
    if (k >= SHAPES || isGaze(k)) return value;
    if (BLINKS.includes(k)) return clamp((value - neutral[k]) / (closed[k] - neutral[k]), 0, 1);
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
  firstS = NaN;
  /** Faces at rest, and with closed eyes; and what they come to. @type {ArrayLike<number>[][]} */
  watched = [[], []];
  neutral = new Float64Array(SHAPES);
  closed = this.neutral;

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
    const pose = calibrated(face, this.neutral, this.closed);
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
    const [rest, closed] = this.watched;
    if (!rest.length) this.firstS = atS;
    const sinceS = atS - this.firstS;
    if (sinceS < REST_S) rest.push(face);
    else if (sinceS >= CLOSED_S && sinceS < KNOWN_S) closed.push(face);
    else return;
    [this.neutral, this.closed] = [medians(rest), medians(closed)];
    for (const k of BLINKS) this.neutral[k] = Math.min(this.neutral[k], MAX_OPEN);
    const isClosed = BLINKS.every((k) => this.closed[k] - this.neutral[k] >= LEAST_LID_RANGE);
    if (!isClosed) this.closed.fill(1);
  }

  /** What the person is to do now. */
  get wish() {
    const sinceS = this.atS - this.firstS;
    if (!(sinceS >= REST_S)) return "look ahead with a relaxed face for a moment";
    return sinceS < KNOWN_S ? "now close both eyes for three seconds" : "";
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
