/**
 * The voices of a call: heard, each with its face in step, and one's own sent. A packet is placed
 * on its sender's time line as a face is, decoded by the browser at once, and waits in the audio
 * worklet for its moment.
 */

import { SenderClock, seconds } from "./clock.js";

const RATE_HZ = 48_000;
const FRAME_S = 0.02;
/** What the browser's decoder and the way to the audio thread take (chosen: two pictures). */
const DECODE_S = 0.03;
const CEILING_S = 0.2;
const [LEAST_JITTER_S, JITTER_SHARE] = [0.01, 0.97];
/** Time in which two thirds of a delay that is no longer needed are given up. */
const RELEASE_S = 5;
const SILENT_S = 1.5;
/** What comes out of Opus was put in so much before the packet's first sample; of the limiter. */
const [CODEC_DELAY_S, LIMITER_S] = [0.0065, 0.006];
const [SPEAKING_LEVEL, SPEAKING_HOLD_S] = [10 ** (-45 / 20), 0.5];
const BITRATE_BPS = 24_000;
/** A packet up to this size holds silence: it is not sent. */
const SILENT_BYTES = 4;

/** One voice, from its packets to the audio thread. */
class Ear {
  clock = new SenderClock(JITTER_SHARE);
  waitS = Infinity;
  fastestS = Infinity;
  arrivedS = -Infinity;
  spokeS = -Infinity;
  /** When a moment of the voice leaves the loudspeaker, and which. */
  leavesS = NaN;
  mediaS = NaN;
  /** @type {number[]} */
  pending = [];
  /** @type {AudioDecoder | null} */
  decoder = null;

  /** @param {Voice} voice @param {AudioContext} context */
  constructor(voice, context) {
    this.voice = voice;
    this.node = new AudioWorkletNode(context, "pica-voice",
      { numberOfInputs: 0, outputChannelCount: [1] });
    this.node.connect(/** @type {AudioNode} */ (voice.limiter));
    this.node.port.onmessage = ({ data: { timeS, mediaS, level } }) => {
      [this.leavesS, this.mediaS] =
        [timeS + voice.offsetS + (context.outputLatency || context.baseLatency), mediaS];
      if (level > SPEAKING_LEVEL) this.spokeS = seconds();
    };
  }

  /** @param {Frame} frame @param {number} now */
  receive(frame, now) {
    const elapsedS = Math.max(now - this.arrivedS, 0);
    this.arrivedS = now;
    const mediaS = this.clock.place(frame, now);
    if (mediaS === null) return;
    this.clock.learn(mediaS, now);
    this.aim(elapsedS);
    if (this.decoder === null || this.decoder.state === "closed") this.decoder = this.newDecoder();
    this.pending.push(mediaS);
    // A copy: the frame lies in the message that it came with.
    const data = frame.payload.slice();
    this.decoder.decode(
      new EncodedAudioChunk({ type: "key", timestamp: Math.round(mediaS * 1e6), data }));
  }

  newDecoder() {
    this.pending = [];
    const decoder = new AudioDecoder({
      output: (sound) => {
        const pcm = new Float32Array(sound.numberOfFrames);
        sound.copyTo(pcm, { planeIndex: 0, format: "f32-planar" });
        sound.close();
        const mediaS = this.pending.shift();
        const waitS = this.waitS - this.voice.offsetS; // on the clock of the audio thread
        if (mediaS !== undefined) {
          this.node.port.postMessage({ mediaS, pcm, waitS, isOver: false }, [pcm.buffer]);
        }
      },
      error: () => {}, // it is closed, and the next packet gets another
    });
    decoder.configure({ codec: "opus", sampleRate: RATE_HZ, numberOfChannels: 1 });
    return decoder;
  }

  /** Wait longer at once, and less slowly. @param {number} elapsedS */
  aim(elapsedS) {
    const { fastestS, jitterS } = this.clock;
    const beginS = fastestS + FRAME_S + DECODE_S;
    const neededS = beginS + Math.min(jitterS, CEILING_S - FRAME_S);
    const enoughS = Math.max(neededS, beginS + LEAST_JITTER_S);
    if (this.waitS === Infinity) this.waitS = enoughS;
    else this.waitS += Math.min(fastestS - this.fastestS, 0);
    this.fastestS = fastestS;
    const excessS = Math.max(this.waitS - enoughS, 0);
    this.waitS = Math.max(this.waitS - excessS * (1 - Math.exp(-elapsedS / RELEASE_S)), neededS);
  }
}

/** All that is heard and said. What must wait for a person's tap is `start`. */
export class Voice {
  needsTap = false;
  isMuted = true;
  isSealed = false;
  /** What is wrong with microphone or loudspeaker, in one line. */
  note = "";
  /** @type {Map<string, Ear>} */
  ears = new Map();
  /** @type {AudioContext | null} */
  context = null;
  /** Keeps the sum of all voices from being cut. @type {AudioNode | null} */
  limiter = null;
  /** @type {MediaStream | null} */
  microphone = null;
  /** @type {AudioEncoder | null} */
  encoder = null;
  /** From the clock of the audio thread to ours. */
  offsetS = 0;

  /** @param {() => void} changed Called when `needsTap`, `isMuted` or `note` change.
   * @param {(payload: Uint8Array, capturedUs: number) => void} send */
  constructor(changed, send) {
    this.changed = changed;
    this.send = send;
    /** Takes what is said and not muted: samples, and when the last one was heard. @type {(pcm:
     * Float32Array, endS: number) => void} */
    this.onSound = () => {};
  }

  /** Get ready to be heard; a browser may want a tap first. */
  async open() {
    if (typeof AudioDecoder === "undefined") {
      this.say("this browser cannot play voices: it has no WebCodecs");
      return;
    }
    const context = new AudioContext({ sampleRate: RATE_HZ, latencyHint: "interactive" });
    this.context = context;
    await context.audioWorklet.addModule(new URL("worklet.js", import.meta.url));
    this.limiter =
      new DynamicsCompressorNode(context, { threshold: -3, knee: 0, ratio: 20, attack: 0.001 });
    this.limiter.connect(context.destination);
    const noteState = () => {
      this.needsTap = context.state === "suspended";
      this.offsetS = seconds() - context.currentTime;
      this.changed();
    };
    context.onstatechange = noteState;
    noteState();
  }

  async start() {
    await this.context?.resume();
  }

  /** @param {string} note */
  say(note) {
    this.note = note;
    this.changed();
  }

  close() {
    for (const track of this.microphone?.getTracks() ?? []) track.stop();
    this.context?.close();
    this.context = null;
  }

  /** @param {string} id @param {Frame} frame @param {number} now */
  receive(id, frame, now) {
    if (this.limiter === null || this.context?.state !== "running") return;
    const ear = this.ears.get(id) ?? new Ear(this, this.context);
    this.ears.set(id, ear);
    ear.receive(frame, now);
  }

  /** Forget all but those who are there. @param {ReadonlyMap<string, unknown>} present */
  keep(present) {
    for (const [id, { node }] of this.ears) {
      if (present.has(id)) continue;
      node.port.postMessage({ isOver: true });
      node.disconnect();
      this.ears.delete(id);
    }
    if (this.context?.state !== "running") return;
    // Reading takes up to a block of sound too long, so it is smoothed.
    this.offsetS += 0.1 * (seconds() - this.context.currentTime - this.offsetS);
  }

  /** The sender's moment that is heard, microseconds; null for silence. @param {string} id
   * @param {number} now */
  heardUs(id, now) {
    const ear = this.ears.get(id);
    if (!ear || !(Math.abs(now - ear.leavesS) < SILENT_S) || now - ear.arrivedS > SILENT_S) {
      return null;
    }
    const mediaS = ear.mediaS - CODEC_DELAY_S - LIMITER_S + now - ear.leavesS;
    return ear.clock.originUs + Math.round((mediaS - ear.clock.originS) * 1e6);
  }

  /** @param {string} id @param {number} now */
  isSpeaking(id, now) {
    return now - (this.ears.get(id)?.spokeS ?? -Infinity) < SPEAKING_HOLD_S;
  }

  /** Open a microphone and speak. */
  async speak() {
    const { context } = this;
    if (!context) return;
    try {
      if (!navigator.mediaDevices) throw new Error("the browser gives one to pages by https only");
      const stream = this.microphone ?? await navigator.mediaDevices.getUserMedia({
        audio: { echoCancellation: true, noiseSuppression: true, autoGainControl: true,
          channelCount: 1 },
      });
      if (this.microphone === null) this.listen(context, stream);
      this.microphone = stream;
      this.note = "";
      await context.resume();
      this.mute(false);
    } catch (error) {
      const isRefused = error instanceof DOMException && error.name === "NotAllowedError";
      this.say(isRefused ? "the browser was not allowed to use the microphone"
        : `no microphone: ${error}`);
    }
  }

  /** @param {AudioContext} context @param {MediaStream} stream */
  listen(context, stream) {
    const frames = new AudioWorkletNode(context, "pica-microphone", { numberOfOutputs: 0 });
    const source = context.createMediaStreamSource(stream);
    source.connect(frames);
    frames.port.onmessage = ({ data }) => this.said(data.pcm, data.endS + this.offsetS);
    stream.getAudioTracks()[0].onended = () => {
      source.disconnect();
      this.microphone = null;
      this.mute(true);
      this.say("the microphone is gone");
    };
  }

  /** @param {boolean} isMuted */
  mute(isMuted) {
    this.isMuted = isMuted || this.microphone === null;
    this.encoder?.close();
    this.encoder = this.isMuted ? null : this.newEncoder();
    this.changed();
  }

  newEncoder() {
    // The compiler does not know all options of Opus.
    const opus = /** @type {OpusEncoderConfig} */ (
      { frameDuration: 40_000, application: "voip", usedtx: !this.isSealed });
    const encoder = new AudioEncoder({
      output: (chunk) => {
        const payload = new Uint8Array(chunk.byteLength);
        chunk.copyTo(payload);
        if (payload.length > SILENT_BYTES) this.send(payload, chunk.timestamp);
      },
      error: (error) => this.say(`the browser cannot encode the voice: ${error.message}`),
    });
    encoder.configure({
      codec: "opus", sampleRate: RATE_HZ, numberOfChannels: 1, bitrate: BITRATE_BPS,
      // Sizes that follow the sounds tell words (RFC 6562).
      bitrateMode: this.isSealed ? "constant" : "variable",
      opus,
    });
    return encoder;
  }

  /** @param {Float32Array<ArrayBuffer>} pcm 20 ms. @param {number} endS When its last sample was
   * heard. */
  said(pcm, endS) {
    if (this.encoder === null) return;
    this.onSound(pcm, endS);
    const sound = new AudioData({
      format: "f32-planar", sampleRate: RATE_HZ, numberOfChannels: 1, numberOfFrames: pcm.length,
      timestamp: Math.round((endS - FRAME_S) * 1e6), data: pcm,
    });
    this.encoder.encode(sound);
    sound.close();
  }
}
