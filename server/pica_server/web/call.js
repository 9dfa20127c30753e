/**
 * A call: who is in the room, and the face of each at display time.
 *
 * @module
 */

import { seconds } from "./clock.js";
import { Link } from "./link.js";
import { LatentError, decodeFace, StreamProfile } from "./latent_stream.js";
import { Playout } from "./playout.js";
import { Guard, readSecret } from "./sframe.js";
import { VOICE_TRACK, Voice } from "./voice.js";

/** @import { AvatarFile, CallStatus, CallSurface, Face, OpenAvatar, Participant } from "./types.js" */
/** @import { Frame, Message, Peer, Track } from "./wire.js" */

const LOWER_AFTER_S = 0.5;
const LOWER_INTERVAL_S = 1;
const STALE_AFTER_S = 2;
const PLACE_IS_KEPT_S = 120;
const MAX_AVATAR_BYTES = 64 * 2 ** 20;
/** Between two tries to get an avatar file, which its owner may still be giving. */
const FETCH_WAITS_S = [0.5, 1, 2, 4, 8];
const TICK_MS = 250;
const FACE_NOTES = { muted: "face is off", lost: "no face in front of the tracker" };

/** @type {Record<string, string>} */
const SEAL_NOTES = {
  plain: "not encrypted",
  "secret differs": "secret differs: compare the links",
  relabelled: "not who the relay says it is",
};

/** Gets avatar files from the relay, checks and reads each once. @template {AvatarFile} T */
class Avatars {
  /** @param {URL} base @param {OpenAvatar<T>} open */
  constructor(base, open) {
    this.base = base;
    this.open = open;
    /** @type {Map<string, Promise<T>>} */
    this.found = new Map();
  }

  /** Rejects with one clear line. @param {string} id @returns {Promise<T>} */
  get(id) {
    let found = this.found.get(id);
    if (found === undefined) {
      found = this.fetch(id);
      found.catch(() => this.found.delete(id));
      this.found.set(id, found);
    }
    return found;
  }

  /** @param {string} id @returns {Promise<T>} */
  async fetch(id) {
    const response = await fetch(new URL(`avatars/${id}`, this.base), { credentials: "omit" });
    if (response.status === 404) throw new Error("the relay does not have the avatar yet");
    if (!response.ok) throw new Error(`no avatar: the relay answers HTTP ${response.status}`);
    if (Number(response.headers.get("Content-Length")) > MAX_AVATAR_BYTES) {
      throw new Error("the avatar's file is too large");
    }
    const bytes = await response.arrayBuffer();
    const digest = await crypto.subtle.digest("SHA-256", bytes);
    const hex = Array.from(new Uint8Array(digest), (byte) => byte.toString(16).padStart(2, "0"));
    if (hex.join("") !== id) throw new Error("the relay gave another file than asked for");
    return this.open(bytes, id);
  }
}

/** Another member of the room, and what has come of its face. @template {AvatarFile} T */
class Member {
  /** @param {Call<T>} call @param {Peer} peer @param {number} place @param {string} name */
  constructor(call, peer, place, name) {
    this.call = call;
    this.peer = peer;
    this.id = peer.peer_id;
    this.place = place;
    this.name = name;
    this.track = peer.tracks.find((track) => track.kind === "face");
    this.voice = peer.tracks.find((track) => track.kind === "voice");
    this.avatarId = this.track?.avatar ?? "";
    /** @type {T | null} */
    this.avatar = null;
    /** @type {StreamProfile | null} */
    this.profile = null;
    this.trouble = "";
    this.isAway = false;
    this.isSpeaking = false;
    /** Whether it has sent us a key that we can do nothing with. */
    this.isSealed = false;
    this.gain = 1;
    /** @type {Participant["seal"]} */
    this.seal = "";
    this.playout = new Playout();
    /** @type {ReturnType<Playout["sampleAt"]>} */
    this.played = null;
    this.isHeld = false;
    this.arrivedS = NaN;
    this.told = 1;
    this.wanted = 1;
    this.lowerS = Infinity;
    this.loweredS = -Infinity;
  }

  get isFaceMuted() {
    return this.peer.metadata.face === "muted" || this.isStopped(this.track);
  }

  get isVoiceMuted() {
    return Boolean(this.voice) && (this.peer.metadata.voice === "muted" || this.isStopped(this.voice));
  }

  get isRecording() {
    return this.peer.metadata.records === "yes";
  }

  /** @param {Track | undefined} track */
  isStopped(track) {
    return track !== undefined && this.call.link !== null && this.call.link.mutedStreams.has(track.stream);
  }

  get note() {
    if (this.isSealed) return "encrypted: the room's secret is needed";
    if (this.trouble) return this.trouble;
    if (this.seal && SEAL_NOTES[this.seal]) return SEAL_NOTES[this.seal];
    if (this.isStopped(this.track)) return "muted by an admin";
    if (this.isAway) return "connection lost";
    if (!this.track) return "watching";
    const said = this.peer.metadata.face;
    return said === "muted" || said === "lost" ? FACE_NOTES[said] : "";
  }

  /** Get the avatar, again and again while it is not there. @param {number} [tries] */
  async dress(tries = 0) {
    try {
      const avatar = await this.call.avatars.get(this.avatarId);
      this.profile = new StreamProfile((name) => avatar.integers(name));
      this.avatar = avatar;
      this.trouble = "";
    } catch (error) {
      this.trouble = said(error);
      const waitS = FETCH_WAITS_S[Math.min(tries, FETCH_WAITS_S.length - 1)];
      if (this.call.members.get(this.id) !== this) return;
      setTimeout(() => this.dress(tries + 1), waitS * 1000);
    }
    this.call.say("people");
  }

  /** @param {Frame} frame @param {number} now */
  receive(frame, now) {
    if (this.profile === null) return;
    this.arrivedS = now;
    try {
      const sample = decodeFace(this.profile, frame.payload);
      if (!this.told) return; // it was under way when it was unsubscribed
      this.playout.receive(frame, sample, now);
      this.isHeld = false;
    } catch (error) {
      if (!(error instanceof LatentError)) throw error;
      this.call.errors += 1;
    }
  }

  /** @param {number} now @returns {Face | null} */
  faceAt(now) {
    if (!this.isHeld) {
      this.played = this.playout.sampleAt(now, this.call.heardUs(this.id, now));
    }
    if (this.played === null) return null;
    const { values, isConcealed } = this.played;
    const [latent, rotation, translation] = [values.subarray(0, 256), values.subarray(256, 259), values.subarray(259)];
    /** @type {Face["status"]} */
    let status = this.isHeld || isConcealed ? "concealed" : "live";
    if (this.peer.metadata.face === "lost") status = "away";
    else if (this.told && now - this.arrivedS > STALE_AFTER_S) status = "stale";
    return { latent, rotation, translation, status };
  }

  /** @param {0 | 1 | 2 | 4} every */
  want(every) {
    if (every === this.wanted) return;
    this.wanted = every;
    const now = seconds();
    if (share(every) >= share(this.told)) this.lowerS = Infinity;
    else if (this.lowerS === Infinity) {
      this.lowerS = Math.max(now + LOWER_AFTER_S, this.loweredS + LOWER_INTERVAL_S);
    }
    this.tellWant(now);
  }

  /** More is told at once, less late. @param {number} now */
  tellWant(now) {
    const isMore = share(this.wanted) > share(this.told);
    if (this.wanted === this.told || (!isMore && now < this.lowerS) || !this.track) return;
    const { stream } = this.track;
    if (!this.call.link?.tell({ type: "subscribe", stream, every: this.wanted })) return;
    if (!isMore) this.loweredS = now;
    this.lowerS = Infinity;
    this.noteTold(this.wanted, now);
  }

  /** @param {number} every @param {number} now */
  noteTold(every, now) {
    if (!this.told) this.arrivedS = now; // until now none was expected
    this.told = every;
    this.isHeld ||= every === 0;
  }
}

/** @param {number} every @returns {number} The share of the frames that are sent. */
function share(every) {
  return every ? 1 / every : 0;
}

/**
 * A call, as `CallSurface` in `types.js` describes it.
 *
 * @template {AvatarFile} T
 * @implements {CallSurface<T>}
 */
export class Call extends EventTarget {
  /** @param {{openAvatar: OpenAvatar<T>, base: URL | string}} options */
  constructor({ openAvatar, base }) {
    super();
    this.base = new URL(base);
    this.avatars = new Avatars(this.base, openAvatar);
    /** @type {Map<string, Member<T>>} */
    this.members = new Map();
    /** @type {Map<number, Member<T>>} */
    this.byStream = new Map();
    /** Places of those who have gone, by name: place, and when it was left. */
    this.places = /** @type {Map<string, [number, number]>} */ (new Map());
    this.numPlaces = 0;
    this.errors = 0;
    /** @type {Link | null} */
    this.link = null;
    /** @type {Guard | null} */
    this.guard = null;
    /** What the encryption does, one after the other. @type {Promise<void>} */
    this.sealing = Promise.resolve();
    /** @type {Participant<T> | null} */
    this.self = null;
    this.voice = new Voice(new URL(".", import.meta.url), () => this.noteVoice(),
      (payload, capturedUs) => this.publish("voice", payload, capturedUs));
    /** @type {CallStatus} */
    this.status = { state: "joining", reason: "", room: "", name: "", code: "", isEncrypted: false };
  }

  get participants() {
    return [...this.members.values()].sort((one, other) => one.place - other.place);
  }

  /** @param {string} type */
  say(type) {
    this.dispatchEvent(new Event(type));
  }

  /** @param {Partial<CallStatus>} change */
  setStatus(change) {
    this.status = { ...this.status, ...change };
    this.say("status");
  }

  /** @param {{room: string, token: string, secret: string, name: string, avatarId?: string}} where */
  join({ room, token, secret, name, avatarId = "" }) {
    const claims = claimsOf(token);
    const url = new URL(this.base);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.setStatus({ room, name: claims.name ?? name, isEncrypted: secret !== "" });
    if (crypto.subtle === undefined) {
      this.setStatus({ state: "ended", reason: "open this page by https: the browser has no cryptography here" });
      return;
    }
    /** @type {Track[]} */
    const face = avatarId ? [{ kind: "face", policy: "latest", avatar: avatarId, stream: 0, deadline_ms: 0 }] : [];
    const tracks = claims.publish === false ? [] : [...face, VOICE_TRACK];
    const link = new Link(url.href, { room, token, name, tracks }, {
      message: (message) => this.receive(message),
      frame: (frame) => this.receiveFrame(frame),
      left: (state, reason) => {
        if (state === "ended") this.ownFace?.close();
        this.setStatus({ state, reason });
      },
    });
    this.link = link;
    if (tracks.length) link.metadata = { voice: "muted" };
    try {
      if (secret) {
        this.guard = new Guard(readSecret(secret), (peer_id, data) => link.tell({ type: "whisper", peer_id, data }));
        this.voice.isSealed = true;
        this.after(() => this.guard?.begin(room, this.status.name));
      }
    } catch (error) {
      this.setStatus({ state: "ended", reason: said(error) });
      return;
    }
    this.voice.open().catch((error) => this.voice.say(`no sound: ${said(error)}`));
    link.connect();
    if (tracks.length > 1) {
      this.wear(avatarId, name).catch((error) => this.voice.say(`no face is sent: ${said(error)}`));
    }
    this.timer = setInterval(() => this.tick(), TICK_MS);
  }

  leave() {
    clearInterval(this.timer);
    this.link?.leave();
    this.voice.close();
    this.ownFace?.close();
    this.setStatus({ state: "ended", reason: "" });
  }

  /** Send a face, which the voice moves, and see it as the others do. @param {string} avatarId @param {string} name */
  async wear(avatarId, name) {
    const { OwnFace, openMouth } = await import("./face.js");
    const [avatar, mouth] = await Promise.all([this.avatars.get(avatarId), openMouth(new URL(".", import.meta.url))]);
    if (this.status.state === "ended") return;
    const tracks = [{ kind: "face", policy: "latest", avatar: avatarId, stream: 1, deadline_ms: 0 }];
    const peer = { peer_id: "self", name, tracks, metadata: {}, identity: "", is_name_assured: false };
    const own = new Member(this, peer, -1, name);
    own.avatar = avatar;
    own.profile = new StreamProfile((name) => avatar.integers(name));
    this.self = own;
    let sequence = 0;
    const face = new OwnFace(avatar, mouth, (payload, capturedUs, multiple) => {
      this.publish("face", payload, capturedUs, multiple);
      own.receive({ stream: 1, sequence, capturedUs, payload }, seconds());
      sequence = (sequence + 1) % 65_536;
    });
    this.ownFace = face;
    this.voice.onSound = (pcm, endS) => face.hear(pcm, endS);
    this.say("people");
  }

  /** Let the encryption do something after all that came before. @param {() => Promise<void> | undefined} work */
  after(work) {
    this.sealing = this.sealing.then(work).catch((error) => console.error(error));
  }

  /** @param {string} kind @param {Uint8Array} payload @param {number} capturedUs @param {number} [multiple] */
  publish(kind, payload, capturedUs, multiple = 1) {
    const { link, guard } = this;
    const place = link?.tracks.findIndex((track) => track.kind === kind) ?? -1;
    const frame = place < 0 ? null : link?.number(place, payload, capturedUs, multiple);
    if (!frame) return;
    if (guard === null) link?.send(frame);
    else this.after(async () => link?.send(await guard.seal(frame, seconds())));
  }

  noteVoice() {
    this.link?.describe("voice", this.voice.isMuted && this.link.tracks.length ? "muted" : "");
    this.say("voice");
  }

  /** @param {string} id @param {number} now @returns {number | null} */
  heardUs(id, now) {
    return this.voice.heardUs(id, now);
  }

  tick() {
    const now = seconds();
    let isNews = false;
    for (const member of this.members.values()) {
      member.tellWant(now);
      const isSpeaking = this.voice.isSpeaking(member.id, now);
      isNews ||= isSpeaking !== member.isSpeaking;
      member.isSpeaking = isSpeaking;
    }
    this.voice.seat(new Map(this.participants.map((member) => [member.id, member.gain])));
    const { guard } = this;
    if (guard !== null) this.after(() => this.tickGuard(guard));
    if (isNews) this.say("people");
  }

  /** @param {Guard} guard */
  async tickGuard(guard) {
    if (!this.link?.isJoined) return;
    await guard.tick(seconds());
    let isNews = false;
    for (const [id, { state }] of guard.peers) {
      const member = this.members.get(id);
      isNews ||= member !== undefined && member.seal !== state;
      if (member) member.seal = state;
    }
    if (isNews) this.say("people");
    if (guard.code !== this.status.code) this.setStatus({ code: guard.code });
  }

  /** @param {Message} message */
  receive(message) {
    const { guard } = this;
    if (guard === null) {
      this.note(message);
      return;
    }
    this.after(async () => {
      if (await guard.receive(message, seconds())) this.note(message);
      await this.tickGuard(guard);
    });
  }

  /** @param {Frame} frame */
  receiveFrame(frame) {
    const now = seconds();
    const { guard } = this;
    if (guard === null) {
      if (!this.byStream.get(frame.stream)?.isSealed) this.play(frame, now);
      return;
    }
    this.after(async () => {
      const opened = await guard.open(frame, seconds());
      if (opened !== null) this.play(opened, now);
    });
  }

  /** @param {Frame} frame @param {number} now */
  play(frame, now) {
    const member = this.byStream.get(frame.stream);
    if (member?.voice?.stream === frame.stream) this.voice.receive(member.id, frame, now);
    else member?.receive(frame, now);
  }

  /** @param {Message} message */
  note(message) {
    const member = this.members.get(message.peer_id);
    switch (message.type) {
      case "joined":
        this.enter(message);
        break;
      case "peer_joined":
        this.add(message.peer);
        break;
      case "peer_left":
        if (member) this.remove(member);
        break;
      case "peer_away":
      case "peer_back":
        if (member) member.isAway = message.type === "peer_away";
        break;
      case "whisper":
        if (member) member.isSealed = true;
        break;
      case "peer_updated":
        if (member) member.peer = { ...member.peer, metadata: message.metadata };
        break;
    }
    this.say("people");
  }

  /** @param {Message} joined */
  enter({ peers, name }) {
    /** @type {Map<string, Peer>} */
    const present = new Map(peers.map((/** @type {Peer} */ peer) => [peer.peer_id, peer]));
    for (const member of [...this.members.values()]) {
      const peer = present.get(member.id);
      if (peer !== undefined && isSame(peer, member.peer)) {
        member.peer = peer;
        member.isAway = false;
        member.lowerS = member.wanted === 1 ? Infinity : seconds();
        member.noteTold(1, seconds());
        present.delete(member.id);
      } else {
        this.remove(member);
      }
    }
    for (const peer of present.values()) this.add(peer);
    this.setStatus({ state: "joined", reason: "", name: name || this.status.name });
  }

  /** @param {Peer} peer */
  add(peer) {
    const names = new Set(this.participants.map((member) => member.name));
    let name = peer.name;
    for (let number = 2; names.has(name); number++) name = `${peer.name} (${number})`;
    const [place, leftS] = this.places.get(name) ?? [0, -Infinity];
    const isKept = seconds() - leftS < PLACE_IS_KEPT_S;
    this.places.delete(name);
    const member = new Member(this, peer, isKept ? place : this.numPlaces++, name);
    this.members.set(peer.peer_id, member);
    for (const track of [member.track, member.voice]) if (track) this.byStream.set(track.stream, member);
    for (const track of peer.tracks) {
      const isKnown = track === member.track || track === member.voice;
      if (!isKnown) this.link?.tell({ type: "subscribe", stream: track.stream, every: 0 });
    }
    if (member.avatarId) member.dress();
  }

  /** @param {Member<T>} member */
  remove(member) {
    this.members.delete(member.id);
    for (const track of member.peer.tracks) this.byStream.delete(track.stream);
    this.places.set(member.name, [member.place, seconds()]);
    if (this.places.size > 64) this.places.delete([...this.places.keys()][0]);
  }
}

/** @param {unknown} error @returns {string} */
function said(error) {
  return error instanceof Error ? error.message : String(error);
}

/** What a token says of its owner; the relay checks it. @param {string} token @returns {{name?: string, publish?: boolean}} */
function claimsOf(token) {
  try {
    const text = atob(token.split(".")[1].replaceAll("-", "+").replaceAll("_", "/"));
    const claims = JSON.parse(new TextDecoder().decode(Uint8Array.from(text, (char) => char.charCodeAt(0))));
    return { ...(typeof claims.name === "string" ? { name: claims.name } : {}), publish: claims.publish === true };
  } catch {
    return {};
  }
}

/** Whether a peer is the one that had its id before. @param {Peer} one @param {Peer} other */
function isSame(one, other) {
  return JSON.stringify({ ...one, metadata: {} }) === JSON.stringify({ ...other, metadata: {} });
}
