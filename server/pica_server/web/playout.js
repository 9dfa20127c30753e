/**
 * From frames as the network delivers them to a face at display time. Pure: `now` is an argument.
 *
 * A frame is due at its capture time plus the fastest transit plus a delay; between two frames the
 * face moves evenly, without a next one it rests, and when the path changes, what is shown goes
 * over to the new one. All rules are those of `pica_client.playout`, where they are explained.
 *
 * @module
 */

import { FrameInterval, SenderClock } from "./clock.js";

/** @import { LatentSample } from "./types.js" */
/** @import { Frame } from "./wire.js" */

const FLOOR_S = 0.004;
const CEILING_S = 0.2;
const MAX_LAG_S = 0.03;
const MIN_SLACK_S = 0.005;
const STILL_S = 2.5;
const MAX_LED_S = 2;

const NUM_SHOWN = 9;
const MAX_FRAMES = 64;
const MAX_GAP_S = 0.25;
const BLEND_S = 0.15;
const UNSEEN = 1e-5;
const LEAP_S = 0.25;
const FASTER = 0.1;
const SLOWER = 0.25;
const LED_RATE = 1;
const LED_LEAP_S = 0.04;
const SMOOTHING = 0.1;
const MAX_STEP_S = 0.25;

/** @typedef {{capturedUs: number, sample: LatentSample, mediaS: number}} DecodedFrame */

/** @param {LatentSample} face @returns {Float32Array} Latent, rotation, translation: 262 values. */
function flat(face) {
  const values = new Float32Array(262);
  values.set(face.latent);
  values.set(face.rotation, 256);
  values.set(face.translation, 259);
  return values;
}

/** @param {Float32Array} values @param {boolean} isStill @returns {LatentSample} */
function unflat(values, isStill) {
  return {
    latent: values.subarray(0, 256),
    rotation: values.subarray(256, 259),
    translation: values.subarray(259),
    isStill,
  };
}

/**
 * @param {Float32Array} one
 * @param {Float32Array} other
 * @param {number} weight
 * @returns {Float32Array} One plus the weighted other.
 */
function added(one, other, weight) {
  return one.map((value, i) => value + weight * other[i]);
}

/** @param {Float32Array} values @returns {number} */
function largest(values) {
  return values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
}

/** Takes what is shown back to where it should be, within `BLEND_S`. */
class Correction {
  constructor() {
    this.leftS = 0;
    /** @type {Float32Array | null} */
    this.offset = null;
  }

  /** @param {LatentSample} shown @param {LatentSample} meant At the same moment. */
  aim(shown, meant) {
    if (shown === meant && this.offset === null) return;
    const offset = added(flat(shown), flat(meant), -1);
    if (this.offset !== null && largest(added(offset, this.offset, -1)) < UNSEEN) return;
    this.offset = largest(offset) >= UNSEEN ? offset : null;
    this.leftS = BLEND_S;
  }

  /** @param {LatentSample} meant @param {number} elapsedS @returns {LatentSample} */
  corrected(meant, elapsedS) {
    if (this.offset === null || this.leftS <= elapsedS) {
      this.offset = null;
      return meant;
    }
    const share = 1 - elapsedS / this.leftS;
    this.offset = this.offset.map((value) => share * value);
    this.leftS -= elapsedS;
    return unflat(added(flat(meant), this.offset, 1), meant.isStill);
  }
}

/** Frames shown and to be shown, in order. */
class Timeline {
  constructor() {
    /** @type {DecodedFrame[]} */
    this.frames = [];
    this.numShown = 0;
  }

  /** The newest frame that counts as shown, and the oldest that does not. */
  get held() {
    return this.frames[this.numShown - 1];
  }

  get following() {
    return this.frames[this.numShown];
  }

  get newestS() {
    return this.frames[this.frames.length - 1].mediaS;
  }

  /** @param {number} mediaS @returns {number} How many frames were captured up to then. */
  countTo(mediaS) {
    return this.frames.filter((frame) => frame.mediaS <= mediaS).length;
  }

  /** @param {DecodedFrame} frame @returns {boolean} */
  append(frame) {
    const place = this.countTo(frame.mediaS);
    if (place < this.numShown) return false;
    this.frames.splice(place, Infinity, frame);
    if (this.frames.length - this.numShown > MAX_FRAMES) this.frames.splice(this.numShown, 1);
    return true;
  }

  /** @param {number} mediaS */
  release(mediaS) {
    this.numShown = Math.max(this.countTo(mediaS), this.numShown);
    const numOld = Math.max(this.numShown - NUM_SHOWN, 0);
    this.frames.splice(0, numOld);
    this.numShown -= numOld;
  }

  /** @param {number} mediaS @param {number} intervalS @returns {LatentSample} */
  faceAt(mediaS, intervalS) {
    const place = Math.max(this.countTo(mediaS) - 1, 0);
    const before = this.frames[place];
    const departureS = this.departureS(place, intervalS);
    if (mediaS < departureS) return before.sample;
    const after = this.frames[place + 1];
    const share = (mediaS - departureS) / (after.mediaS - departureS);
    if (share === 0) return before.sample;
    if (share === 1) return after.sample;
    const one = flat(before.sample);
    return unflat(added(one, added(flat(after.sample), one, -1), share), false);
  }

  /** @param {number} mediaS @param {number} intervalS @returns {boolean} */
  isUnderWay(mediaS, intervalS) {
    return this.departureS(Math.max(this.countTo(mediaS) - 1, 0), intervalS) <= mediaS;
  }

  /** @param {number} place @param {number} intervalS @returns {number} */
  departureS(place, intervalS) {
    const before = this.frames[place];
    const after = this.frames[place + 1];
    if (after === undefined) return Infinity;
    const longestS = before.sample.isStill && intervalS > 0 ? intervalS : MAX_GAP_S;
    return Math.max(before.mediaS, after.mediaS - longestS);
  }
}

/** The display's time of one stream. */
class Playhead {
  constructor() {
    this.positionS = -Infinity;
    /** Mean time between two display times. */
    this.stepS = 0;
    this.now = -Infinity;
  }

  /**
   * @param {number} now
   * @param {number} targetS The moment that should be shown.
   * @param {number} endS Up to where the face last shown had moved.
   * @param {boolean} isLed Whether a voice says what should be shown.
   */
  advance(now, targetS, endS, isLed) {
    if (this.positionS === -Infinity) {
      this.positionS = targetS;
      this.now = now;
      return { elapsedS: 0, movedS: 0, isLeap: false };
    }
    const elapsedS = Math.max(now - this.now, 0);
    this.now = Math.max(now, this.now);
    if (elapsedS <= MAX_STEP_S) this.stepS += SMOOTHING * (elapsedS - this.stepS);
    const beforeS = this.positionS;
    const behindS = targetS - beforeS - elapsedS;
    if (behindS > (isLed ? LED_LEAP_S : LEAP_S)) {
      this.positionS = targetS;
      return { elapsedS, movedS: elapsedS, isLeap: true };
    }
    const slowest = -(isLed ? LED_RATE : SLOWER) * elapsedS;
    const rate = Math.min(Math.max(behindS, slowest), (isLed ? LED_RATE : FASTER) * elapsedS);
    let positionS = beforeS + elapsedS + rate;
    if (endS < positionS && targetS < positionS) {
      positionS = Math.max(targetS, Math.min(endS, positionS));
    }
    this.positionS = positionS;
    return { elapsedS, movedS: Math.max(positionS - beforeS, 0), isLeap: false };
  }
}

/** The playout buffer of one stream. */
export class Playout {
  constructor() {
    this.sender = new SenderClock();
    this.timeline = new Timeline();
    this.interval = new FrameInterval();
    this.playhead = new Playhead();
    this.correction = new Correction();
    /** @type {LatentSample | null} */
    this.shown = null;
    this.endS = Infinity;
    this.isPathNew = false;
  }

  /** @param {Frame} frame @param {LatentSample} sample @param {number} now */
  receive(frame, sample, now) {
    const placed = this.sender.receive(frame, now);
    if (placed === null) return;
    const { mediaS } = placed;
    if (!this.timeline.append({ capturedUs: frame.capturedUs, sample, mediaS })) return;
    this.isPathNew = true;
    this.sender.transit?.receive(mediaS, now);
    this.interval.receive(mediaS, sample.isStill);
  }

  /**
   * The face to show next, or null before the first frame is due.
   *
   * @param {number} now
   * @param {number | null} [heardUs] The moment, on the sender's clock, of the voice that is heard
   *     when this face is seen. It leads.
   * @returns {{sample: LatentSample, capturedUs: number, isConcealed: boolean} | null}
   */
  sampleAt(now, heardUs = null) {
    const { timeline } = this;
    const { transit } = this.sender;
    if (transit === null) return null;
    const { intervalS } = this.interval;
    const ownS = now - transit.fastestS - this.targetS;
    let shouldS = ownS;
    let isLed = false;
    if (heardUs !== null) {
      const heardS = this.sender.mediaS(heardUs);
      isLed = Math.abs(heardS - ownS) <= MAX_LED_S;
      if (isLed) shouldS = Math.min(Math.max(ownS, heardS - MAX_LAG_S), heardS);
    }
    if (!timeline.held && !(timeline.following?.mediaS <= shouldS)) return null;
    if (this.slackS > 0) shouldS = Math.min(shouldS, timeline.newestS);
    const step = this.playhead.advance(now, shouldS, this.endS, isLed);
    const { positionS } = this.playhead;
    timeline.release(positionS);
    let face = timeline.faceAt(positionS, intervalS);
    if (this.shown !== null) {
      if (this.isPathNew || step.isLeap) {
        this.correction.aim(this.shown, timeline.faceAt(positionS - step.movedS, intervalS));
      }
      face = this.correction.corrected(face, step.elapsedS);
    }
    this.shown = face;
    this.isPathNew = false;
    return this.played(face, positionS, this.slackS ? ownS - this.slackS : positionS);
  }

  /** By how much the display's images lie farther apart than the frames that arrive. */
  get slackS() {
    const { intervalS } = this.interval;
    const slackS = this.playhead.stepS - intervalS;
    return intervalS > 0 && slackS > MIN_SLACK_S ? slackS : 0;
  }

  /** What should be waited beyond the fastest transit. */
  get targetS() {
    const jitterS = this.sender.transit?.jitterS ?? 0;
    const waitS = Math.min(Math.max(FLOOR_S, this.interval.intervalS) + jitterS, CEILING_S);
    return Math.max(waitS - this.slackS, FLOOR_S);
  }

  /**
   * Describe how fresh a face is, and remember where it stands.
   *
   * @param {LatentSample} face
   * @param {number} positionS
   * @param {number} dueS Frames captured before it should have come by now.
   */
  played(face, positionS, dueS) {
    const { timeline } = this;
    const { intervalS } = this.interval;
    const held = timeline.held;
    const pastS = dueS - held.mediaS;
    let knownS = held.mediaS;
    let isConcealed = false;
    this.endS = Infinity;
    if (timeline.following && timeline.isUnderWay(positionS, intervalS)) {
      knownS = positionS;
    } else if (held.sample.isStill) {
      knownS += Math.min(Math.max(pastS, 0), STILL_S);
      isConcealed = pastS > STILL_S;
    } else {
      this.endS = held.mediaS;
      const grantedS = Math.max(this.targetS - (this.sender.transit?.jitterS ?? 0), 0);
      isConcealed = pastS > 1.5 * intervalS - grantedS && intervalS > 0;
    }
    const capturedUs = held.capturedUs + Math.round((knownS - held.mediaS) * 1e6);
    return { sample: face, capturedUs, isConcealed };
  }
}
