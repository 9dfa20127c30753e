/**
 * From frames as the network delivers them to a face at display time. Pure: `now` is an argument.
 *
 * A frame is due at its capture time plus the fastest transit plus a delay; between two frames the
 * face moves evenly, without a next one it rests, and when the path changes, what is shown goes
 * over to the new one. All rules are those of `pica_client.playout`, where they are explained.
 */

import { SenderClock } from "./clock.js";

/** @typedef {Sample & {mediaS: number}} Placed */

const [FLOOR_S, CEILING_S] = [0.004, 0.2];
const [MAX_LAG_S, MAX_LED_S] = [0.03, 2];
const MIN_SLACK_S = 0.005;
const [NUM_GAPS, NUM_SHOWN, MAX_FRAMES, MAX_GAP_S] = [16, 9, 64, 0.25];
const [BLEND_S, UNSEEN] = [0.15, 1e-5];
const [LEAP_S, FASTER, SLOWER] = [0.25, 0.1, 0.25];
const [LED_LEAP_S, LED_RATE] = [0.04, 1];
const [SMOOTHING, MAX_STEP_S] = [0.1, 0.25];

/** One plus the weighted other.
 * @type {(one: Float32Array, other: Float32Array, weight: number) => Float32Array} */
const added = (one, other, weight) => one.map((value, i) => value + weight * other[i]);
/** @param {Float32Array} values */
const largest = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);

/** Frames shown and to be shown, in order. */
class Timeline {
  /** @type {Placed[]} */
  frames = [];
  numShown = 0;
  /** Median time between frames. */
  intervalS = 0;
  /** @type {number[]} */
  gaps = [];

  /** The newest frame that counts as shown; none before the first is due. */
  get held() {
    return this.frames[this.numShown - 1];
  }

  /** How many frames were captured up to then. @param {number} mediaS */
  countTo(mediaS) {
    return this.frames.filter((frame) => frame.mediaS <= mediaS).length;
  }

  /** False: it is too late. @param {Placed} frame */
  append(frame) {
    const place = this.countTo(frame.mediaS);
    if (place < this.numShown) return false;
    this.frames.splice(place, Infinity, frame);
    if (this.frames.length - this.numShown > MAX_FRAMES) this.frames.splice(this.numShown, 1);
    return true;
  }

  /** What follows a still frame is a silence on purpose, and no gap. @param {Placed | null} last
   * @param {Placed} frame */
  noteGap(last, { mediaS }) {
    if (last === null || last.isStill || mediaS <= last.mediaS) return;
    this.gaps = [...this.gaps, mediaS - last.mediaS].slice(-NUM_GAPS);
    this.intervalS = Float64Array.from(this.gaps).sort()[(this.gaps.length - 1) >> 1];
  }

  /** Count what was captured up to then as shown. @param {number} mediaS */
  release(mediaS) {
    this.numShown = Math.max(this.countTo(mediaS), this.numShown);
    const numOld = Math.max(this.numShown - NUM_SHOWN, 0);
    this.frames.splice(0, numOld);
    this.numShown -= numOld;
  }

  /** The face of a moment, and whether it is on its way to the next frame.
   * @param {number} mediaS */
  faceAt(mediaS) {
    const place = Math.max(this.countTo(mediaS) - 1, 0);
    const [before, after] = this.frames.slice(place, place + 2);
    if (!after) return { values: before.values, isUnderWay: false };
    const longestS = before.isStill && this.intervalS > 0 ? this.intervalS : MAX_GAP_S;
    const departureS = Math.max(before.mediaS, after.mediaS - longestS);
    const share = (mediaS - departureS) / (after.mediaS - departureS);
    if (share <= 0) return { values: before.values, isUnderWay: share === 0 };
    const way = added(after.values, before.values, -1);
    return { values: added(before.values, way, share), isUnderWay: true };
  }
}

/** The playout buffer of one stream. */
export class Playout {
  clock = new SenderClock();
  timeline = new Timeline();
  /** @type {Placed | null} */
  last = null;
  /** The display's moment on the time line, when that was, and the mean time between two. */
  positionS = -Infinity;
  drawnS = -Infinity;
  stepS = 0;
  /** @type {Float32Array | null} */
  shown = null;
  /** Where the face shown comes to rest. */
  endS = Infinity;
  isPathNew = false;
  /** What takes the face shown back to where it should be, and for how long. @type {Float32Array |
   * null} */
  offset = null;
  leftS = 0;

  /** @type {(frame: {sequence: number, capturedUs: number}, sample: Sample, now: number) => void} */
  receive(frame, sample, now) {
    const mediaS = this.clock.place(frame, now);
    const placed = { ...sample, mediaS: mediaS ?? 0 };
    if (mediaS === null || !this.timeline.append(placed)) return;
    this.isPathNew = true;
    this.clock.learn(mediaS, now);
    this.timeline.noteGap(this.last, placed);
    this.last = placed;
  }

  /** The values of the face to show next, or null before the first frame is due.
   * @param {number} now @param {number | null} heardUs The moment, on the sender's clock, of the
   * voice that is heard when this face is seen. It leads. */
  sampleAt(now, heardUs = null) {
    const { clock, timeline } = this;
    if (!clock.hasBegun || !timeline.frames.length) return null;
    const ownS = now - clock.fastestS - this.targetS;
    const heardS = heardUs === null ? NaN : clock.mediaS(heardUs);
    const isLed = Math.abs(heardS - ownS) <= MAX_LED_S;
    let shouldS = isLed ? Math.min(Math.max(ownS, heardS - MAX_LAG_S), heardS) : ownS;
    if (!timeline.held && !(timeline.frames[0].mediaS <= shouldS)) return null;
    if (this.slackS > 0) {
      shouldS = Math.min(shouldS, timeline.frames[timeline.frames.length - 1].mediaS);
    }
    const step = this.advance(now, shouldS, isLed);
    timeline.release(this.positionS);
    const meant = timeline.faceAt(this.positionS);
    const isTurning = this.isPathNew || step.isLeap;
    const before = isTurning ? timeline.faceAt(this.positionS - step.movedS).values : null;
    this.shown = this.corrected(meant.values, before, step.elapsedS);
    this.isPathNew = false;
    const { held } = timeline;
    this.endS = meant.isUnderWay || held.isStill ? Infinity : held.mediaS;
    return this.shown;
  }

  /** By how much the display's images lie farther apart than the frames that arrive. */
  get slackS() {
    const slackS = this.stepS - this.timeline.intervalS;
    return this.timeline.intervalS > 0 && slackS > MIN_SLACK_S ? slackS : 0;
  }

  /** What should be waited beyond the fastest transit. */
  get targetS() {
    const waitS = Math.max(FLOOR_S, this.timeline.intervalS) + this.clock.jitterS;
    return Math.max(Math.min(waitS, CEILING_S) - this.slackS, FLOOR_S);
  }

  /** Move the display's moment towards the one that should be shown. @type {(now: number, shouldS:
   * number, isLed: boolean) => {elapsedS: number, movedS: number, isLeap: boolean}} */
  advance(now, shouldS, isLed) {
    if (this.positionS === -Infinity) {
      [this.positionS, this.drawnS] = [shouldS, now];
      return { elapsedS: 0, movedS: 0, isLeap: false };
    }
    const elapsedS = Math.max(now - this.drawnS, 0);
    this.drawnS = Math.max(now, this.drawnS);
    if (elapsedS <= MAX_STEP_S) this.stepS += SMOOTHING * (elapsedS - this.stepS);
    const beforeS = this.positionS;
    const behindS = shouldS - beforeS - elapsedS;
    if (behindS > (isLed ? LED_LEAP_S : LEAP_S)) {
      this.positionS = shouldS;
      return { elapsedS, movedS: elapsedS, isLeap: true };
    }
    const slowest = -(isLed ? LED_RATE : SLOWER) * elapsedS;
    const rate = Math.min(Math.max(behindS, slowest), (isLed ? LED_RATE : FASTER) * elapsedS);
    const aimS = beforeS + elapsedS + rate;
    const isPast = this.endS < aimS && shouldS < aimS;
    this.positionS = isPast ? Math.max(shouldS, Math.min(this.endS, aimS)) : aimS;
    return { elapsedS, movedS: Math.max(this.positionS - beforeS, 0), isLeap: false };
  }

  /** What is meant, plus what is left of the way from what was shown.
   * @param {Float32Array} meant @param {Float32Array | null} before What is meant now for the
   * moment that was shown, where that has changed. @param {number} elapsedS */
  corrected(meant, before, elapsedS) {
    if (before && this.shown && !(this.shown === before && this.offset === null)) {
      const offset = added(this.shown, before, -1);
      if (this.offset === null || largest(added(offset, this.offset, -1)) >= UNSEEN) {
        this.offset = largest(offset) >= UNSEEN ? offset : null;
        this.leftS = BLEND_S;
      }
    }
    if (this.offset === null || this.leftS <= elapsedS) {
      this.offset = null;
      return meant;
    }
    const share = 1 - elapsedS / this.leftS;
    this.offset = this.offset.map((value) => share * value);
    this.leftS -= elapsedS;
    return added(meant, this.offset, 1);
  }
}
