/** A call: who is in the room, and the face of each at display time. */

import { MAX_FILE_BYTES, openAvatar } from "./avatar.js";
import { seconds } from "./clock.js";
import { LatentError, decodeFace, openEncoder } from "./latent_stream.js";
import { Link } from "./link.js";
import { Playout } from "./playout.js";
import { Guard, readSecret } from "./sframe.js";
import { Voice } from "./voice.js";
import { fromBase64, said } from "./wire.js";

const [LOWER_INTERVAL_S, STALE_AFTER_S] = [1, 2];
const PLACE_IS_KEPT_S = 120;
/** Between two tries to get an avatar, which its owner may still be giving. */
const FETCH_WAITS_S = [0.5, 1, 2, 4, 8];
const [TICK_MS, FIRST_FACE_MS] = [250, 1000];
/** @type {Record<string, string>} */
const FACE_NOTES = { muted: "face is muted", lost: "no face in front of the tracker" };
/** @type {Record<SealState, string>} */
const SEAL_NOTES = {
  waiting: "not verified yet", verified: "", plain: "not encrypted",
  "secret differs": "has another secret: compare the links",
  relabelled: "not who the relay says it is",
};

/** @type {Map<string, Promise<Avatar>>} */
const avatars = new Map();
/** Files come one by one; after the first its face is drawn. @type {Promise<unknown>} */
let fetching = Promise.resolve();

/** Get an avatar from the relay, checked and read once; rejects with one clear line.
 * @param {URL} base @param {string} id */
function getAvatar(base, id) {
  const found = avatars.get(id) ?? fetching.then(async () => openAvatar(await getFile(base, id)));
  if (!avatars.has(id)) {
    const waitMs = avatars.size ? 0 : FIRST_FACE_MS;
    fetching = found.catch(() => avatars.delete(id))
      .then(() => new Promise((resolve) => setTimeout(resolve, waitMs)));
  }
  avatars.set(id, found);
  return found;
}

/** Get a file of the relay's store, checked; rejects with one clear line. @param {URL} base
 * @param {string} id */
export async function getFile(base, id) {
  const response = await fetch(new URL(`avatars/${id}`, base), { credentials: "omit" });
  if (response.status === 404) throw new Error("the relay does not have the avatar yet");
  if (!response.ok) throw new Error(`no avatar: the relay answers HTTP ${response.status}`);
  const isLarge = Number(response.headers.get("Content-Length")) > MAX_FILE_BYTES;
  if (isLarge) throw new Error("the avatar's file is too large");
  const bytes = await response.arrayBuffer();
  if (await idOf(bytes) !== id) throw new Error("the relay gave another file than asked for");
  return bytes;
}

/** The id of a file: its SHA-256. @param {ArrayBuffer} bytes */
export async function idOf(bytes) {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** A member of the room, and what has come of its face. */
export class Member {
  /** @type {Avatar | null} */
  avatar = null;
  /** @type {ReturnType<typeof openEncoder> | null} */
  encode = null;
  trouble = "";
  isAway = false;
  isSpeaking = false;
  /** Whether it has sent us a key that we can do nothing with. */
  isSealed = false;
  /** @type {SealState} */
  seal = "verified";
  playout = new Playout();
  /** @type {Float32Array | null} */
  played = null;
  isHeld = false;
  arrivedS = NaN;
  /** Every which frame of its face the relay sends us; 0 is none. */
  every = 1;
  loweredS = -Infinity;

  /** @param {Call} call @param {Peer} peer @param {number} place In the order of coming.
   * @param {string} name With a number where two have the same. */
  constructor(call, peer, place, name) {
    this.call = call;
    this.peer = peer;
    this.id = peer.peer_id;
    this.place = place;
    this.name = name;
    this.track = peer.tracks.find((track) => track.kind === "face");
    this.voice = peer.tracks.find((track) => track.kind === "voice");
  }

  /** @param {Track | undefined} track */
  isStopped(track) {
    return track !== undefined && (this.call.link?.mutedStreams.has(track.stream) ?? false);
  }

  /** How it is with this participant, in a few words; empty for nothing to say. */
  get state() {
    const { metadata } = this.peer;
    if (this.isAway) return "connection lost";
    const face = [
      this.isSealed ? "encrypted: the room's secret is needed" : "",
      this.trouble,
      this.isStopped(this.track) ? "muted by an admin" : "",
      this.track ? FACE_NOTES[metadata.face] : "watching",
      this.avatar || !this.track ? "" : "avatar is loading",
    ].find(Boolean);
    const isVoiceMuted = this.voice && (metadata.voice === "muted" || this.isStopped(this.voice));
    const states = [
      face, SEAL_NOTES[this.seal], isVoiceMuted ? "muted" : "",
      metadata.records === "yes" ? "records" : "",
    ];
    return states.filter(Boolean).join(" · ");
  }

  /** Get the avatar, again and again while it is not there. @param {number} tries */
  async dress(tries = 0) {
    if (!this.track?.avatar) return;
    try {
      const avatar = await getAvatar(this.call.base, this.track.avatar);
      this.encode = openEncoder(avatar);
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
    if (this.encode === null || !this.every) return; // it was under way when it was unsubscribed
    this.arrivedS = now;
    try {
      this.playout.receive(frame, decodeFace(this.encode, frame.payload), now);
      this.isHeld = false;
    } catch (error) {
      if (!(error instanceof LatentError)) throw error;
    }
  }

  /** The face to be shown now, to be asked once for each picture; null before the first.
   * @param {number} now @returns {Face | null} */
  faceAt(now) {
    if (!this.isHeld) {
      this.played = this.playout.sampleAt(now, this.call.voice.heardUs(this.id, now));
    }
    if (this.played === null) return null;
    const isStale = this.isAway || (this.every > 0 && now - this.arrivedS > STALE_AFTER_S);
    const status = isStale ? "stale" : this.peer.metadata.face === "lost" ? "away" : "live";
    return { values: this.played, status };
  }

  /** Say which share of the stream is needed: all, a half, a quarter, none. The relay is told of
   * less once a second at most. @param {number} every */
  want(every) {
    const now = seconds();
    const isLess = (every || Infinity) > (this.every || Infinity);
    if (!this.track || every === this.every) return;
    if (isLess && now < this.loweredS + LOWER_INTERVAL_S) return;
    if (!this.call.link?.tell({ type: "subscribe", stream: this.track.stream, every })) return;
    if (isLess) this.loweredS = now;
    if (!this.every) this.arrivedS = now; // until now none was expected
    this.every = every;
    this.isHeld ||= every === 0;
  }
}

/** Says `people`, `status` or `voice` when `members`, `status` or `voice` have changed. */
export class Call extends EventTarget {
  /** @type {Map<string, Member>} */
  members = new Map();
  /** @type {Map<number, Member>} */
  byStream = new Map();
  /** Places of those who have gone, by name: place, and when it was left. @type {Map<string,
   * [number, number]>} */
  places = new Map();
  numPlaces = 0;
  /** @type {Link | null} */
  link = null;
  /** @type {Guard | null} */
  guard = null;
  /** What the encryption does, one after the other. */
  sealing = Promise.resolve();
  /** Our own face as the others get it. @type {Member | null} */
  self = null;
  /** @type {import("./face.js").OwnFace | null} */
  ownFace = null;
  /** @type {import("./camera.js").Camera | null} */
  camera = null;
  /** @type {{state: "joining" | "joined" | "reconnecting" | "ended", reason: string, code:
   * string}} */
  status = { state: "joining", reason: "", code: "" };
  timer = 0;

  /** @param {URL} base Of the relay. */
  constructor(base) {
    super();
    this.base = base;
    this.voice = new Voice(() => this.noteVoice(),
      (payload, capturedUs) => this.publish("voice", payload, capturedUs, 1));
  }

  /** The others, in the order of coming. */
  get participants() {
    return [...this.members.values()].sort((one, other) => one.place - other.place);
  }

  /** @param {string} type */
  say(type) {
    this.dispatchEvent(new Event(type));
  }

  /** @param {Partial<typeof this.status>} change */
  setStatus(change) {
    Object.assign(this.status, change);
    if (this.status.state === "ended") {
      clearInterval(this.timer);
      this.camera?.close();
      this.ownFace?.close();
      this.voice.close();
    }
    this.say("status");
  }

  /** @param {{room: string, token: string, secret: string, name: string, avatarId: string}} where
   * With an avatar we send a face. */
  join({ room, token, secret, name, avatarId }) {
    const claims = claimsOf(token);
    const url = new URL(this.base);
    url.protocol = url.protocol.replace("http", "ws");
    const face = { kind: "face", avatar: avatarId, stream: 0, deadline_ms: 0 };
    const voice = { kind: "voice", avatar: "", stream: 0, deadline_ms: 200 };
    const tracks = claims.publish === false ? [] : avatarId ? [face, voice] : [voice];
    const link = new Link(url.href, { room, token, name, tracks }, {
      message: (message) => this.receive(message),
      frame: (frame) => this.receiveFrame(frame),
      left: (state, reason) => this.setStatus({ state, reason }),
    });
    this.link = link;
    if (tracks.length) link.metadata = { voice: "muted" };
    try {
      if (!crypto.subtle) {
        throw new Error("open this page by https: the browser has no cryptography here");
      }
      if (secret) {
        const guard = new Guard(readSecret(secret),
          (peer_id, data) => link.tell({ type: "whisper", peer_id, data }));
        this.guard = guard;
        this.voice.isSealed = true;
        this.after(() => guard.begin(room, claims.name ?? name));
      }
    } catch (error) {
      this.setStatus({ state: "ended", reason: said(error) });
      return;
    }
    link.connect();
    this.voice.open().catch((error) => this.voice.say(`no sound: ${said(error)}`));
    if (tracks.includes(face)) {
      this.wear(avatarId, name).catch((error) => this.voice.say(`no face is sent: ${said(error)}`));
    }
    this.timer = setInterval(() => this.tick(), TICK_MS);
  }

  leave() {
    this.link?.leave();
    this.setStatus({ state: "ended", reason: "" });
  }

  /** Send a face, which the voice moves, and see it as the others do. @param {string} avatar
   * @param {string} name */
  async wear(avatar, name) {
    const { OwnFace } = await import("./face.js");
    const track = { kind: "face", avatar, stream: 1, deadline_ms: 0 };
    const own = new Member(this,
      { peer_id: "self", name, tracks: [track], metadata: {} }, -1, name);
    await own.dress();
    let sequence = 0;
    const face = await OwnFace.open((payload, capturedUs, multiple) => {
      this.publish("face", payload, capturedUs, multiple);
      own.receive({ stream: 1, sequence, capturedUs, payload }, seconds());
      sequence = (sequence + 1) % 65_536;
    });
    if (this.status.state === "ended") return face.close();
    this.self = own;
    this.ownFace = face;
    this.voice.onSound = (pcm, endS) => face.hear(pcm, endS);
    this.say("people");
  }

  /** Let a camera move our face, or no longer. */
  async toggleCamera() {
    if (this.camera?.isOpen) return this.camera.close();
    const { Camera } = await import("./camera.js");
    const camera = new Camera((face, capturedS) => this.ownFace?.see(face, capturedS),
      () => this.say("camera"));
    this.camera = camera;
    return camera.open(this.base);
  }

  /** Let the encryption do something after all that came before.
   * @param {() => Promise<void>} work */
  after(work) {
    this.sealing = this.sealing.then(work).catch((error) => console.error(error));
  }

  /** @param {"face" | "voice"} kind @param {Uint8Array} payload @param {number} capturedUs
   * @param {number} multiple */
  publish(kind, payload, capturedUs, multiple) {
    const { link, guard } = this;
    const frame = link?.number(kind, payload, capturedUs, multiple);
    if (!frame) return;
    this.after(async () =>
      link?.send(guard ? await guard.seal(frame, kind === "face", seconds()) : frame));
  }

  noteVoice() {
    this.link?.describe("voice", this.voice.isMuted && this.link.tracks.length ? "muted" : "");
    this.say("voice");
  }

  tick() {
    const now = seconds();
    for (const member of this.members.values()) {
      const isSpeaking = this.voice.isSpeaking(member.id, now);
      if (isSpeaking !== member.isSpeaking) this.say("people");
      member.isSpeaking = isSpeaking;
    }
    this.voice.keep(this.members);
    const { guard } = this;
    if (guard !== null) this.after(() => this.tickGuard(guard));
  }

  /** @param {Guard} guard */
  async tickGuard(guard) {
    if (!this.link?.isJoined) return;
    await guard.tick(seconds());
    for (const [id, { state }] of guard.peers) {
      const member = this.members.get(id);
      if (!member || member.seal === state) continue;
      member.seal = state;
      this.say("people");
    }
    if (guard.code !== this.status.code) this.setStatus({ code: guard.code });
  }

  /** @param {Message} message */
  receive(message) {
    const { guard } = this;
    this.after(async () => {
      await guard?.receive(message, seconds());
      if (guard === null || message.type !== "whisper") this.note(message);
      if (guard !== null) await this.tickGuard(guard);
    });
  }

  /** @param {Frame} frame */
  receiveFrame(frame) {
    const now = seconds();
    const { guard } = this;
    this.after(async () => {
      const member = this.byStream.get(frame.stream);
      if (!member || (guard === null && member.isSealed)) return;
      const isFace = member.track?.stream === frame.stream;
      const opened = guard ? await guard.open(frame, member.id, isFace, seconds()) : frame;
      if (!opened) return;
      if (isFace) member.receive(opened, now);
      else if (member.voice?.stream === frame.stream) this.voice.receive(member.id, opened, now);
    });
  }

  /** @param {Message} message */
  note(message) {
    const member = this.members.get(message.peer_id);
    if (message.type === "joined") {
      for (const each of this.participants) this.remove(each);
      for (const peer of message.peers) this.add(peer);
      this.setStatus({ state: "joined", reason: "" });
    } else if (message.type === "peer_joined") {
      this.remove(this.members.get(message.peer.peer_id));
      this.add(message.peer);
    } else if (message.type === "peer_left") {
      this.remove(member);
    } else if (member) {
      if (message.type === "peer_updated") member.peer.metadata = message.metadata;
      if (message.type === "peer_away") member.isAway = message.is_away;
      if (message.type === "whisper") member.isSealed = true;
    }
    this.say("people");
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
    for (const track of peer.tracks) {
      this.byStream.set(track.stream, member);
      const isKnown = track === member.track || track === member.voice;
      if (!isKnown) this.link?.tell({ type: "subscribe", stream: track.stream, every: 0 });
    }
    member.dress();
  }

  /** @param {Member | undefined} member */
  remove(member) {
    if (!member) return;
    this.members.delete(member.id);
    for (const track of member.peer.tracks) this.byStream.delete(track.stream);
    this.places.set(member.name, [member.place, seconds()]);
    if (this.places.size > 64) this.places.delete([...this.places.keys()][0]);
  }
}

/** What a token says of its owner; the relay checks it. @param {string} token @returns {{name?:
 * string, publish?: boolean}} */
function claimsOf(token) {
  try {
    const { name, publish } =
      JSON.parse(new TextDecoder().decode(fromBase64(token.split(".")[1])));
    return { ...(typeof name === "string" ? { name } : {}), publish: publish === true };
  } catch {
    return {};
  }
}
