/**
 * The voices of a call: heard, each with its face in step, and one's own sent.
 *
 * A packet is placed on its sender's time line as a face is, decoded by the browser at once, and
 * waits in the audio worklet for its moment.
 *
 * @module
 */

import { SenderClock, seconds } from "./clock.js";

/** @import { Frame, Track } from "./wire.js" */

const RATE_HZ = 48_000;
const FRAME_S = 0.02;
/** What the browser's decoder and the way to the audio thread take (chosen: two pictures). */
const DECODE_S = 0.03;
const CEILING_S = 0.2;
const LEAST_JITTER_S = 0.01;
const JITTER_SHARE = 0.97;
/** Time in which two thirds of a delay that is no longer needed are given up. */
const RELEASE_S = 5;
const SILENT_S = 1.5;
/** What comes out of Opus was put in so much before the packet's first sample. */
const CODEC_DELAY_S = 0.0065;
const SPEAKING_LEVEL = 10 ** (-45 / 20);
const SPEAKING_HOLD_S = 0.5;
const BITRATE_BPS = 24_000;
/** A packet up to this size holds silence: it is not sent. */
const SILENT_BYTES = 4;

/** @type {Track} */
export const VOICE_TRACK = { kind: "voice", policy: "ordered", avatar: "", stream: 0, deadline_ms: 200 };

/** One voice, from its packets to the audio thread. */
class Ear {
  /** @param {(mediaS: number, pcm: Float32Array<ArrayBuffer>) => void} play */
  constructor(play) {
    this.play = play;
    this.clock = new SenderClock(JITTER_SHARE);
    this.waitS = Infinity;
    this.fastestS = Infinity;
    this.aimedS = -Infinity;
    this.arrivedS = -Infinity;
    this.spokeS = -Infinity;
    /** When a moment of the voice leaves the loudspeaker, and which. @type {[number, number]} */
    this.moment = [NaN, NaN];
    /** @type {number[]} */
    this.pending = [];
    /** @type {AudioDecoder | null} */
    this.decoder = null;
  }

  /** @param {Frame} frame @param {number} now */
  receive(frame, now) {
    this.arrivedS = now;
    const mediaS = this.clock.place(frame, now);
    if (mediaS === null) return;
    this.clock.learn(mediaS, now);
    this.aim(this.clock, now);
    if (this.decoder === null || this.decoder.state === "closed") this.decoder = this.newDecoder();
    this.pending.push(mediaS);
    const timestamp = Math.round(mediaS * 1e6);
    // A copy: the frame lies in the message that it came with.
    const data = frame.payload.slice();
    this.decoder.decode(new EncodedAudioChunk({ type: "key", timestamp, data }));
  }

  newDecoder() {
    this.pending = [];
    const decoder = new AudioDecoder({
      output: (sound) => {
        const pcm = new Float32Array(sound.numberOfFrames);
        sound.copyTo(pcm, { planeIndex: 0, format: "f32-planar" });
        sound.close();
        const mediaS = this.pending.shift();
        if (mediaS !== undefined) this.play(mediaS, pcm);
      },
      error: () => {}, // it is closed, and the next packet gets another
    });
    decoder.configure({ codec: "opus", sampleRate: RATE_HZ, numberOfChannels: 1 });
    return decoder;
  }

  /** Wait longer at once, and less slowly. @param {{fastestS: number, jitterS: number}} transit @param {number} now */
  aim({ fastestS, jitterS }, now) {
    const elapsedS = Math.max(now - this.aimedS, 0);
    const roomS = CEILING_S - FRAME_S;
    const beginS = fastestS + FRAME_S + DECODE_S;
    const neededS = beginS + Math.min(jitterS, roomS);
    const enoughS = beginS + Math.min(Math.max(jitterS, LEAST_JITTER_S), roomS);
    if (this.waitS === Infinity) this.waitS = enoughS;
    else this.waitS += Math.min(fastestS - this.fastestS, 0);
    this.fastestS = fastestS;
    this.aimedS = now;
    const excessS = Math.max(this.waitS - enoughS, 0);
    this.waitS = Math.max(this.waitS - excessS * (1 - Math.exp(-elapsedS / RELEASE_S)), neededS);
  }

  /** @param {number} now @returns {number | null} The sender's moment that is heard, microseconds. */
  heardUs(now) {
    const [leavesS, mediaS] = this.moment;
    if (!(Math.abs(now - leavesS) < SILENT_S) || now - this.arrivedS > SILENT_S) return null;
    const { originUs, originS } = this.clock;
    return originUs + Math.round((mediaS - CODEC_DELAY_S + now - leavesS - originS) * 1e6);
  }
}

/** All that is heard and said; `changed` is called when `needsTap`, `isMuted` or `note` does. */
export class Voice {
  /**
   * @param {URL | string} base The folder of the modules.
   * @param {() => void} changed
   * @param {(payload: Uint8Array, capturedUs: number) => void} send
   */
  constructor(base, changed, send) {
    this.base = base;
    this.changed = changed;
    this.send = send;
    this.needsTap = false;
    this.isMuted = true;
    this.isSealed = false;
    this.note = "";
    /** @type {Map<string, Ear>} */
    this.ears = new Map();
    /** @type {AudioContext | null} */
    this.context = null;
    /** @type {AudioWorkletNode | null} */
    this.mixer = null;
    /** @type {{stream: MediaStream, nodes: AudioNode[]} | null} */
    this.microphone = null;
    /** @type {AudioEncoder | null} */
    this.encoder = null;
    /** From the clock of the audio thread to ours. */
    this.offsetS = 0;
    /** Takes what is said and not muted: samples, and when the last one was heard. @type {(pcm: Float32Array, endS: number) => void} */
    this.onSound = () => {};
  }

  /** Get ready to be heard; a browser may want a tap first. */
  async open() {
    if (typeof AudioDecoder === "undefined" || typeof AudioWorkletNode === "undefined") {
      this.say("this browser cannot play voices: it has no WebCodecs");
      return;
    }
    const context = (this.context = new AudioContext({ sampleRate: RATE_HZ, latencyHint: "interactive" }));
    await context.audioWorklet.addModule(new URL("worklet.js", this.base));
    const mixer = new AudioWorkletNode(context, "pica-mixer", { numberOfInputs: 0, outputChannelCount: [2] });
    mixer.connect(context.destination);
    mixer.port.onmessage = ({ data }) => this.heard(data);
    this.mixer = mixer;
    context.onstatechange = () => {
      this.needsTap = context.state === "suspended";
      this.offsetS = seconds() - context.currentTime;
      this.changed();
    };
    this.needsTap = context.state === "suspended";
    this.offsetS = seconds() - context.currentTime;
    this.changed();
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
    for (const track of this.microphone?.stream.getTracks() ?? []) track.stop();
    this.context?.close();
  }

  /** @param {string} id @param {Frame} frame @param {number} now */
  receive(id, frame, now) {
    if (this.mixer === null || this.context?.state !== "running") return;
    let ear = this.ears.get(id);
    if (ear === undefined) {
      ear = new Ear((mediaS, pcm) => {
        const waitS = this.ears.get(id)?.waitS;
        this.mixer?.port.postMessage({ id, mediaS, pcm, waitS, clock: this.offsetS }, [pcm.buffer]);
      });
      this.ears.set(id, ear);
    }
    ear.receive(frame, now);
  }

  /** Note who is there and how loud each shall be. @param {ReadonlyMap<string, number>} gains */
  seat(gains) {
    const gone = [...this.ears.keys()].filter((id) => !gains.has(id));
    for (const id of gone) this.ears.delete(id);
    this.mixer?.port.postMessage({ gone });
    for (const [id, gain] of gains) {
      if (this.ears.has(id)) this.mixer?.port.postMessage({ id, gain });
    }
    if (this.context?.state === "running") {
      // Reading takes up to a block of sound too long, so it is smoothed.
      this.offsetS += 0.1 * (seconds() - this.context.currentTime - this.offsetS);
    }
  }

  /** @param {{timeS: number, voices: {id: string, mediaS: number, level: number}[]}} report */
  heard({ timeS, voices }) {
    const latencyS = this.context?.outputLatency || this.context?.baseLatency || 0;
    for (const { id, mediaS, level } of voices) {
      const ear = this.ears.get(id);
      if (ear === undefined) continue;
      ear.moment = [timeS + this.offsetS + latencyS, mediaS];
      if (level > SPEAKING_LEVEL) ear.spokeS = seconds();
    }
  }

  /** @param {string} id @param {number} now */
  heardUs(id, now) {
    return this.ears.get(id)?.heardUs(now) ?? null;
  }

  /** @param {string} id @param {number} now */
  isSpeaking(id, now) {
    return now - (this.ears.get(id)?.spokeS ?? -Infinity) < SPEAKING_HOLD_S;
  }

  /** Open a microphone and speak. @param {string} [deviceId] */
  async speak(deviceId) {
    const { context } = this;
    if (context === null) return;
    if (!navigator.mediaDevices) {
      this.say("no microphone: the browser gives one to pages by https only");
      return;
    }
    try {
      const stream = await navigator.mediaDevices.getUserMedia({
        audio: {
          echoCancellation: true, noiseSuppression: true, autoGainControl: true, channelCount: 1,
          ...(deviceId ? { deviceId: { exact: deviceId } } : {}),
        },
      });
      for (const track of this.microphone?.stream.getTracks() ?? []) track.stop();
      for (const node of this.microphone?.nodes ?? []) node.disconnect();
      const source = context.createMediaStreamSource(stream);
      const frames = new AudioWorkletNode(context, "pica-microphone", { numberOfOutputs: 0 });
      source.connect(frames);
      frames.port.onmessage = ({ data }) => this.said(data.pcm, data.endS + this.offsetS);
      stream.getAudioTracks()[0].onended = () => {
        this.mute(true);
        this.say("the microphone is gone");
      };
      this.microphone = { stream, nodes: [source, frames] };
      this.note = "";
      await context.resume();
      this.mute(false);
    } catch (error) {
      const isRefused = error instanceof DOMException && error.name === "NotAllowedError";
      this.say(isRefused ? "the browser was not allowed to use the microphone" : `no microphone: ${error}`);
    }
  }

  /** @param {boolean} isMuted */
  mute(isMuted) {
    this.isMuted = isMuted || this.microphone === null;
    this.encoder?.close();
    this.encoder = this.isMuted ? null : this.newEncoder();
    this.changed();
  }

  newEncoder() {
    const encoder = new AudioEncoder({
      output: (chunk) => {
        const payload = new Uint8Array(chunk.byteLength);
        chunk.copyTo(payload);
        if (payload.length > SILENT_BYTES) this.send(payload, chunk.timestamp);
      },
      error: (error) => this.say(`the browser cannot encode the voice: ${error.message}`),
    });
    // Sizes that follow the sounds tell words (RFC 6562).
    const opus = { frameDuration: 40_000, application: "voip", usedtx: !this.isSealed };
    encoder.configure({
      codec: "opus", sampleRate: RATE_HZ, numberOfChannels: 1, bitrate: BITRATE_BPS,
      bitrateMode: this.isSealed ? "constant" : "variable", opus,
    });
    return encoder;
  }

  /** @param {Float32Array<ArrayBuffer>} pcm 20 ms. @param {number} endS When its last sample was heard. */
  said(pcm, endS) {
    if (this.encoder === null) return;
    this.onSound(pcm, endS);
    const timestamp = Math.round((endS - FRAME_S) * 1e6);
    const sound = new AudioData({
      format: "f32-planar", sampleRate: RATE_HZ, numberOfChannels: 1, numberOfFrames: pcm.length,
      timestamp, data: pcm,
    });
    this.encoder.encode(sound);
    sound.close();
  }

  /** @param {string} deviceId */
  async playOn(deviceId) {
    const context = /** @type {{setSinkId?: (id: string) => Promise<void>} | null} */ (
      /** @type {unknown} */ (this.context));
    if (context?.setSinkId) await context.setSinkId(deviceId);
    else this.say("this browser plays on the system's loudspeaker only");
  }
}
