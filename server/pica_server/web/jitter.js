/**
 * From pieces of sound as they come to an even sound. Pure; it runs in the audio worklet.
 *
 * What was captured at t is played at t + wait. Where it is quiet, the sound catches up by leaving
 * samples out, or waits; in the middle of speech it goes on where it stopped. The rules are those
 * of `pica_client.voice.jitter_buffer`, but for lost packets: no codec conceals them here, so the
 * last sound fades.
 *
 * @module
 */

const RATE_HZ = 48_000;
/** Speech this far behind is left out. */
const LEAP_S = 0.35;
const LEAST_ERROR_S = 0.003;
const MAX_PIECES = 32;
/** Root mean square below which sound is quiet: -46 dB. */
const QUIET = 0.005;
/** Samples of a fade: 5 ms. */
const FADE = 240;

/** The sound of one voice. */
export class VoiceBuffer {
  constructor() {
    /** @type {{mediaS: number, pcm: Float32Array}[]} */
    this.pieces = [];
    this.waitS = Infinity;
    this.gain = 1;
    /** Samples of the first piece that were played. */
    this.at = 0;
    /** Where the sound stands on the time line; no number: nothing was played. */
    this.mediaS = NaN;
    this.isQuiet = true;
    this.last = 0;
    this.fade = 0;
  }

  /** @param {number} mediaS When it was captured. @param {Float32Array} pcm @param {number} waitS */
  push(mediaS, pcm, waitS) {
    this.pieces.push({ mediaS, pcm });
    if (this.pieces.length > MAX_PIECES) this.next();
    this.waitS = waitS;
  }

  next() {
    this.pieces.shift();
    this.at = 0;
  }

  /** @param {number} size Of samples. @returns {number} Root mean square of what comes. */
  loudness(size) {
    const sound = this.pieces[0].pcm.subarray(this.at, this.at + size);
    return Math.sqrt(sound.reduce((sum, value) => sum + value * value, 0) / Math.max(sound.length, 1));
  }

  /**
   * Add the next samples to what others say.
   *
   * @param {Float32Array} out
   * @param {number} now On the clock of the waits.
   * @returns {number} Root mean square of what was added.
   */
  pull(out, now) {
    const size = out.length;
    const shouldS = now - this.waitS;
    this.skip(shouldS, size);
    let power = 0;
    for (let i = 0; i < size; i++) {
      const piece = this.pieces[0];
      // What was captured after a silence waits for its time, and speech that is early does not.
      const isDue = piece && (this.at > 0 || piece.mediaS <= shouldS + i / RATE_HZ + 0.001
        || (!this.isQuiet && piece.mediaS < this.mediaS + 0.005));
      if (!isDue) {
        this.last *= 1 - 1 / FADE;
        this.fade = FADE;
        out[i] += this.gain * this.last;
        continue;
      }
      const rise = this.fade > 0 ? this.fade-- / FADE : 0;
      const value = piece.pcm[this.at] * (1 - rise) + this.last * rise;
      if (!rise) this.last = value;
      out[i] += this.gain * value;
      power += value * value;
      this.at += 1;
      this.mediaS = piece.mediaS + this.at / RATE_HZ;
      if (this.at === piece.pcm.length) this.next();
    }
    const loudness = Math.sqrt(power / size);
    this.isQuiet = loudness < QUIET;
    return loudness;
  }

  /** Leave out what is far too old, and of what is quiet as much as is too old. @param {number} shouldS @param {number} size */
  skip(shouldS, size) {
    while (this.pieces.length) {
      const { mediaS, pcm } = this.pieces[0];
      const behindS = shouldS - (mediaS + this.at / RATE_HZ);
      const isFar = behindS > LEAP_S && this.pieces.length > 1;
      if (!isFar && (behindS < LEAST_ERROR_S || this.loudness(2 * size) > QUIET)) return;
      this.at += size;
      this.fade = FADE;
      if (this.at >= pcm.length) this.next();
    }
  }
}
