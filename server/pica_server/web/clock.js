/**
 * From what a frame says of itself to its place on one even time line, and what arrivals tell: how
 * long frames take, how late some are, how often they come. Pure: `now` is an argument.
 *
 * The rules are those of `pica_client.playout.sender_clock`, where they are explained.
 *
 * @module
 */

import { sequenceDistance } from "./wire.js";

const LATE_S = 10;
const WINDOW_S = 6;
const ATTACK_S = 1;
const ATTACK_SHARE = 0.9;
const ATTACK_MIN_DELAYS = 10;
const CAPACITY = 2048;
const MAX_DELAY_S = 1;
export const RESTART_FRAMES = 1000;
const NUM_GAPS = 16;

/** The time line of one stream. */
export class SenderClock {
  /** @param {number} [share] Of delays that are waited for. */
  constructor(share = 0.95) {
    /** @type {Transit | null} */
    this.transit = null;
    this.share = share;
    this.number = 0;
    this.sequence = 0;
    this.capturedUs = 0;
    this.originUs = 0;
    this.originS = 0;
  }

  /** @param {number} capturedUs @returns {number} Its place on the time line, seconds. */
  mediaS(capturedUs) {
    return this.originS + (capturedUs - this.originUs) / 1e6;
  }

  /**
   * Place a frame that arrived just now; null: it came before, or a newer one did.
   *
   * @param {{sequence: number, capturedUs: number}} frame
   * @param {number} now
   * @returns {{number: number, mediaS: number} | null}
   */
  receive({ sequence, capturedUs }, now) {
    let ahead = sequenceDistance(sequence, this.sequence);
    if (this.transit === null) {
      this.transit = new Transit(now, this.share);
      this.originUs = capturedUs;
      this.number = sequence;
      ahead = 0;
    } else if (this.begins(this.transit, ahead, capturedUs, now)) {
      this.originUs = capturedUs;
      this.originS = now - this.transit.fastestS;
      this.transit = new Transit(this.transit.fastestS, this.share);
      ahead = RESTART_FRAMES + 1;
    } else if (ahead <= 0) {
      return null;
    }
    this.number += ahead;
    this.sequence = sequence;
    this.capturedUs = capturedUs;
    return { number: this.number, mediaS: this.mediaS(capturedUs) };
  }

  /**
   * Whether a frame contradicts the newest one, and so begins again.
   *
   * @param {Transit} transit
   * @param {number} ahead
   * @param {number} capturedUs
   * @param {number} now
   */
  begins(transit, ahead, capturedUs, now) {
    const laterUs = capturedUs - this.capturedUs;
    if (Math.abs(ahead) > RESTART_FRAMES || ahead * laterUs < 0 || (ahead === 0 && laterUs !== 0)) {
      return true;
    }
    return ahead < 0 && now - this.mediaS(capturedUs) - transit.fastestS > LATE_S;
  }
}

/** How long the frames of one stream take. */
export class Transit {
  /** @param {number} transitS @param {number} share Of delays that are waited for. */
  constructor(transitS, share) {
    /** Our clock minus the sender's for a frame that nothing delays. */
    this.fastestS = transitS;
    /** Lateness that should be waited for. */
    this.jitterS = 0;
    this.share = share;
    /** @type {{arrivedS: number, transitS: number, isAlone: boolean}[]} */
    this.arrivals = [];
    this.lastArrivedS = -Infinity;
    this.lastMediaS = -Infinity;
  }

  /** @param {number} mediaS @param {number} arrivedS */
  receive(mediaS, arrivedS) {
    const transitS = arrivedS - mediaS;
    // Of those that a stall held back, the first alone tells how long it was.
    const isBurst = arrivedS - this.lastArrivedS < 0.5 * (mediaS - this.lastMediaS);
    this.lastArrivedS = arrivedS;
    this.lastMediaS = mediaS;
    const arrivals = this.arrivals;
    while (arrivals.length && (arrivals[0].arrivedS < arrivedS - WINDOW_S
        || arrivals.length >= CAPACITY)) {
      arrivals.shift();
    }
    arrivals.push({ arrivedS, transitS, isAlone: !isBurst || !arrivals.length });
    this.fastestS = arrivals.reduce((least, each) => Math.min(least, each.transitS), Infinity);
    const longestS = this.fastestS + MAX_DELAY_S;
    const alone = arrivals.filter((each) => each.isAlone && each.transitS <= longestS);
    const fast = alone.filter((each) => each.arrivedS >= arrivedS - ATTACK_S);
    let waitS = alone.length ? quantile(alone, this.share) : this.fastestS;
    if (fast.length >= ATTACK_MIN_DELAYS) waitS = Math.max(waitS, quantile(fast, ATTACK_SHARE));
    this.jitterS = Math.max(waitS - this.fastestS, 0);
  }
}

/** @param {{transitS: number}[]} arrivals @param {number} share @returns {number} */
function quantile(arrivals, share) {
  const ordered = Float64Array.from(arrivals, (each) => each.transitS).sort();
  return ordered[Math.ceil(share * ordered.length) - 1];
}

/** The time between two frames that arrive: the median of the last gaps. */
export class FrameInterval {
  constructor() {
    this.intervalS = 0;
    /** @type {number[]} */
    this.gaps = [];
    this.lastS = NaN;
    this.wasStill = false;
  }

  /** @param {number} mediaS @param {boolean} isStill */
  receive(mediaS, isStill) {
    // What follows a still frame is a silence on purpose, and no gap.
    if (!this.wasStill && mediaS > this.lastS) {
      this.gaps = [...this.gaps, mediaS - this.lastS].slice(-NUM_GAPS);
      this.intervalS = Float64Array.from(this.gaps).sort()[(this.gaps.length - 1) >> 1];
    }
    this.lastS = mediaS;
    this.wasStill = isStill;
  }
}
