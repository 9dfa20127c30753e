/**
 * From what frames say of themselves to places on one even time line, and what arrivals tell: how
 * long frames take, and how late some are. Pure: `now` is an argument. The rules are those of
 * `pica_client.playout.sender_clock`, where they are explained.
 */

const LATE_S = 10;
const WINDOW_S = 6;
const [ATTACK_S, ATTACK_SHARE, ATTACK_MIN_DELAYS] = [1, 0.9, 10];
const CAPACITY = 2048;
const MAX_DELAY_S = 1;
const RESTART_FRAMES = 1000;

/** The page's clock. */
export const seconds = () => performance.now() / 1000;

/** The time line of one stream. */
export class SenderClock {
  hasBegun = false;
  sequence = 0;
  capturedUs = 0;
  originS = 0;
  originUs = 0;
  /** Our clock minus the sender's for a frame that nothing delays. */
  fastestS = 0;
  /** Lateness that should be waited for. */
  jitterS = 0;
  /** @type {{arrivedS: number, transitS: number, isAlone: boolean}[]} */
  arrivals = [];
  lastArrivedS = -Infinity;
  lastMediaS = -Infinity;

  /** @param {number} share Of delays that are waited for. */
  constructor(share = 0.95) {
    this.share = share;
  }

  /** The place of a moment of the sender on the time line, seconds. @param {number} capturedUs */
  mediaS(capturedUs) {
    return this.originS + (capturedUs - this.originUs) / 1e6;
  }

  /**
   * The place of a frame that arrived just now; null: it came before, or a newer one did.
   * @param {{sequence: number, capturedUs: number}} frame @param {number} now
   */
  place({ sequence, capturedUs }, now) {
    const ahead = ((sequence - this.sequence + 98_304) % 65_536) - 32_768;
    if (!this.hasBegun || this.isRestart(ahead, capturedUs, now)) {
      const fastestS = this.hasBegun ? this.fastestS : now;
      const begun = { ...new SenderClock(this.share), hasBegun: true, fastestS };
      Object.assign(this, begun, { originS: now - fastestS, originUs: capturedUs });
    } else if (ahead <= 0) {
      return null;
    }
    this.sequence = sequence;
    this.capturedUs = capturedUs;
    return this.mediaS(capturedUs);
  }

  /** Whether a frame contradicts the newest one. @type {(ahead: number, capturedUs: number, now:
   * number) => boolean} */
  isRestart(ahead, capturedUs, now) {
    const laterUs = capturedUs - this.capturedUs;
    if (Math.abs(ahead) > RESTART_FRAMES || ahead * laterUs < 0 || (ahead === 0 && laterUs !== 0)) {
      return true;
    }
    return ahead < 0 && now - this.mediaS(capturedUs) - this.fastestS > LATE_S;
  }

  /** Learn from a frame that was placed. @param {number} mediaS @param {number} arrivedS */
  learn(mediaS, arrivedS) {
    // Of those that a stall held back, the first alone tells how long it was.
    const isBurst = arrivedS - this.lastArrivedS < 0.5 * (mediaS - this.lastMediaS);
    [this.lastArrivedS, this.lastMediaS] = [arrivedS, mediaS];
    const kept = this.arrivals.filter((each) => each.arrivedS >= arrivedS - WINDOW_S)
      .slice(1 - CAPACITY);
    kept.push({ arrivedS, transitS: arrivedS - mediaS, isAlone: !isBurst || !kept.length });
    this.arrivals = kept;
    this.fastestS = kept.reduce((least, each) => Math.min(least, each.transitS), Infinity);
    const alone =
      kept.filter((each) => each.isAlone && each.transitS <= this.fastestS + MAX_DELAY_S);
    const fast = alone.filter((each) => each.arrivedS >= arrivedS - ATTACK_S);
    let waitS = alone.length ? quantile(alone, this.share) : this.fastestS;
    if (fast.length >= ATTACK_MIN_DELAYS) waitS = Math.max(waitS, quantile(fast, ATTACK_SHARE));
    this.jitterS = Math.max(waitS - this.fastestS, 0);
  }
}

/** @param {{transitS: number}[]} arrivals @param {number} share */
function quantile(arrivals, share) {
  const ordered = Float64Array.from(arrivals, (each) => each.transitS).sort();
  return ordered[Math.ceil(share * ordered.length) - 1];
}
