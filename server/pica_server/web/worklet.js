/**
 * What runs on the audio thread: `pica-voice` plays one voice, `pica-microphone` hands on what the
 * microphone hears in frames of 20 ms.
 *
 * What was captured at t is played at t + wait. Where it is quiet, a voice catches up by leaving
 * samples out, or waits; in the middle of speech it goes on where it stopped. The rules are those
 * of `pica_client.voice.jitter_buffer`, but for lost packets: no codec conceals them here, so the
 * last sound fades.
 */

const RATE_HZ = 48_000;
const FRAME = 960;
/** Speech this far behind is left out. */
const LEAP_S = 0.35;
const LEAST_ERROR_S = 0.003;
const MAX_PIECES = 32;
/** Root mean square below which sound is quiet: -46 dB. */
const QUIET = 0.005;
/** Samples of a fade: 5 ms. */
const FADE = 240;

// The types of a worklet's scope are in no library of the compiler.
const scope = /** @type {any} */ (globalThis);
/** @type {new () => {port: MessagePort}} */
const Processor = scope.AudioWorkletProcessor;

scope.registerProcessor("pica-voice", class extends Processor {
  constructor() {
    super();
    /** @type {{mediaS: number, pcm: Float32Array}[]} */
    this.pieces = [];
    this.waitS = Infinity;
    /** Samples of the first piece that were played. */
    this.at = 0;
    /** Where the sound stands on the time line; no number: nothing was played. */
    this.mediaS = NaN;
    this.isQuiet = true;
    this.last = 0;
    this.fade = 0;
    this.level = 0;
    this.blocks = 0;
    this.isOver = false;
    this.port.onmessage = ({ data: { mediaS, pcm, waitS, isOver } }) => {
      this.isOver = isOver;
      if (isOver) return;
      this.pieces.push({ mediaS, pcm });
      if (this.pieces.length > MAX_PIECES) this.next();
      this.waitS = waitS;
    };
  }

  next() {
    this.pieces.shift();
    this.at = 0;
  }

  /** @param {Float32Array[][]} _inputs @param {Float32Array[][]} outputs */
  process(_inputs, [[out]]) {
    const shouldS = scope.currentTime - this.waitS;
    this.skip(shouldS, out.length);
    const loudness = Math.sqrt(this.play(out, shouldS) / out.length);
    this.isQuiet = loudness < QUIET;
    this.level = Math.max(this.level, loudness);
    if (++this.blocks % 8 === 0) {
      const timeS = scope.currentTime + out.length / RATE_HZ;
      this.port.postMessage({ timeS, mediaS: this.mediaS, level: this.level });
      this.level = 0;
    }
    return !this.isOver;
  }

  /** Fill in the next samples; the sum of their squares. @param {Float32Array} out
   * @param {number} shouldS */
  play(out, shouldS) {
    let power = 0;
    for (let i = 0; i < out.length; i++) {
      const piece = this.pieces[0];
      // What was captured after a silence waits for its time, and speech that is early does not.
      const isDue = piece && (this.at > 0 || piece.mediaS <= shouldS + i / RATE_HZ + 0.001
        || (!this.isQuiet && piece.mediaS < this.mediaS + 0.005));
      if (isDue) {
        const rise = this.fade > 0 ? this.fade-- / FADE : 0;
        out[i] = piece.pcm[this.at++] * (1 - rise) + this.last * rise;
        if (!rise) this.last = out[i];
        power += out[i] ** 2;
        this.mediaS = piece.mediaS + this.at / RATE_HZ;
        if (this.at === piece.pcm.length) this.next();
      } else {
        this.last *= 1 - 1 / FADE;
        this.fade = FADE;
        out[i] = this.last;
      }
    }
    return power;
  }

  /** Leave out what is far too old, and of what is quiet as much as is too old.
   * @param {number} shouldS @param {number} size */
  skip(shouldS, size) {
    while (this.pieces.length) {
      const { mediaS, pcm } = this.pieces[0];
      const behindS = shouldS - (mediaS + this.at / RATE_HZ);
      const isFar = behindS > LEAP_S && this.pieces.length > 1;
      const sound = pcm.subarray(this.at, this.at + 2 * size);
      const isLoud = sound.reduce((sum, value) => sum + value * value, 0) > QUIET ** 2
        * sound.length;
      if (!isFar && (behindS < LEAST_ERROR_S || isLoud)) return;
      this.at += size;
      this.fade = FADE;
      if (this.at >= pcm.length) this.next();
    }
  }
});

scope.registerProcessor("pica-microphone", class extends Processor {
  constructor() {
    super();
    this.frame = new Float32Array(FRAME);
    this.size = 0;
  }

  /** @param {Float32Array[][]} inputs */
  process([[sound]]) {
    for (const value of sound ?? []) {
      this.frame[this.size++] = value;
      if (this.size === FRAME) {
        this.port.postMessage({ endS: scope.currentTime, pcm: this.frame.slice() });
        this.size = 0;
      }
    }
    return true;
  }
});
