/**
 * What runs on the audio thread: `pica-mixer` plays all voices, `pica-microphone` hands on what the
 * microphone hears in frames of 20 ms.
 *
 * @module
 */

import { VoiceBuffer } from "./jitter.js";

const FRAME = 960;
/** Above it the sum is bent rather than cut. */
const LIMIT_FROM = 0.7;

// The types of a worklet's scope are in no library of the compiler.
const scope = /** @type {any} */ (globalThis);
/** @type {new () => {port: MessagePort}} */
const Processor = scope.AudioWorkletProcessor;

scope.registerProcessor("pica-mixer", class extends Processor {
  constructor() {
    super();
    /** @type {Map<string, VoiceBuffer>} */
    this.voices = new Map();
    this.clock = 0;
    this.blocks = 0;
    /** @type {Map<string, number>} */
    this.levels = new Map();
    this.port.onmessage = ({ data }) => {
      this.clock = data.clock ?? this.clock;
      for (const id of data.gone ?? []) this.voices.delete(id);
      if (data.id === undefined) return;
      let voice = this.voices.get(data.id);
      if (voice === undefined) this.voices.set(data.id, (voice = new VoiceBuffer()));
      if (data.gain !== undefined) voice.gain = data.gain;
      if (data.pcm !== undefined) voice.push(data.mediaS, data.pcm, data.waitS);
    };
  }

  /** @param {Float32Array[][]} _inputs @param {Float32Array[][]} outputs */
  process(_inputs, [channels]) {
    const [mixed] = channels;
    for (const [id, voice] of this.voices) {
      const loudness = voice.pull(mixed, scope.currentTime + this.clock);
      this.levels.set(id, Math.max(loudness, this.levels.get(id) ?? 0));
    }
    mixed.forEach((value, i) => {
      const over = Math.abs(value) - LIMIT_FROM;
      const room = 1 - LIMIT_FROM;
      if (over > 0) mixed[i] = Math.sign(value) * (LIMIT_FROM + room * Math.tanh(over / room));
    });
    for (const channel of channels.slice(1)) channel.set(mixed);
    if (this.voices.size && ++this.blocks % 8 === 0) {
      const voices = Array.from(this.voices, ([id, voice]) =>
        ({ id, mediaS: voice.mediaS, level: this.levels.get(id) }));
      this.port.postMessage({ timeS: scope.currentTime + mixed.length / scope.sampleRate, voices });
      this.levels.clear();
    }
    return true;
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
