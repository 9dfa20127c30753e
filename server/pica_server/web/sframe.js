/**
 * Payloads sealed end to end in the manner of SFrame (RFC 9605), and the keys for it, by WebCrypto.
 * Formats and rules are those of docs/privacy.md; `pica_client.e2ee` is the Python side.
 *
 * @module
 */

import { encodeHeader } from "./wire.js";

/** @import { Frame, Message, Peer, Track } from "./wire.js" */
/** @typedef {Uint8Array<ArrayBuffer>} Bytes */
/** @typedef {{id: number, cipher: CryptoKey, salt: Bytes}} FrameKey */
/** @typedef {"waiting" | "verified" | "plain" | "secret differs" | "relabelled"} SealState */

const { subtle } = crypto;
const FACE_BYTES = 48;
const WINDOW = 1024;
const KEY_IDS = 8;
const MESSAGE_BYTES = 141;
const BODY_BYTES = 93;
const WRAPPED_BYTES = 32;
const CODE_BYTES = 16;
const FRAMES_PER_KEY = 65_536;
const YOUNG_KEY_S = 1;
const LATE_FRAMES_S = 2;
const FIRST_WAIT_S = 0.25;
const LONGEST_WAIT_S = 8;
const SILENT_S = 3;
const MESSAGES_PER_S = 12;
const MESSAGES_AT_ONCE = 96;
const CODE_ROUNDS = 5000;
const NOTHING = new Uint8Array();

/** What does not open, or is no key message. */
export class SealError extends Error {}

const utf8 = new TextEncoder();

/** @param {(string | Uint8Array | number[])[]} parts @returns {Bytes} */
function joined(...parts) {
  return Uint8Array.from(parts.flatMap((part) => [...(typeof part === "string" ? utf8.encode(part) : part)]));
}

/** @param {Uint8Array} one @param {Uint8Array} other @returns {boolean} Whether they are the same. */
function equal(one, other) {
  return one.length === other.length && one.every((byte, i) => byte === other[i]);
}

/** @param {Uint8Array} one @param {Uint8Array} other @returns {number} */
function compare(one, other) {
  const at = one.findIndex((byte, i) => byte !== other[i]);
  return at < 0 ? 0 : one[at] - other[at];
}

/** @param {Uint8Array} secret @param {Bytes} salt @param {Bytes} info @param {number} size */
async function hkdf(secret, salt, info, size) {
  const key = await subtle.importKey("raw", joined(secret), "HKDF", false, ["deriveBits"]);
  return new Uint8Array(await subtle.deriveBits({ name: "HKDF", hash: "SHA-256", salt, info }, key, 8 * size));
}

/** @param {Bytes} key @param {"encrypt" | "decrypt"} use */
function aes(key, use) {
  return subtle.importKey("raw", key, "AES-GCM", false, [use]);
}

// One payload

/** @param {Uint8Array} baseKey @param {number} id @param {"encrypt" | "decrypt"} use @returns {Promise<FrameKey>} */
export async function deriveKey(baseKey, id, use) {
  const suffix = [0, 0, 0, 0, 0, 0, 0, id, 0, 4];
  const key = await hkdf(baseKey, NOTHING, joined("SFrame 1.0 Secret key ", suffix), 16);
  const salt = await hkdf(baseKey, NOTHING, joined("SFrame 1.0 Secret salt ", suffix), 12);
  return { id, cipher: await aes(key, use), salt };
}

/** @param {number} keyId Below 8. @param {number} counter @returns {number[]} */
function encodeSealHeader(keyId, counter) {
  if (counter < 8) return [(keyId << 4) | counter];
  const tail = [];
  for (let rest = counter; rest; rest = Math.floor(rest / 256)) tail.unshift(rest % 256);
  return [(keyId << 4) | 8 | (tail.length - 1), ...tail];
}

/** @param {Uint8Array} sealed @returns {{keyId: number, counter: number, size: number}} */
function decodeSealHeader(sealed) {
  const [config = 128] = sealed;
  const size = config & 8 ? 2 + (config & 7) : 1;
  const counter = size === 1 ? config & 7 : sealed.subarray(1, size).reduce((all, byte) => all * 256 + byte, 0);
  const keyId = config >> 4;
  const isShort = keyId < KEY_IDS && Number.isSafeInteger(counter);
  if (!isShort || !equal(joined(encodeSealHeader(keyId, counter)), sealed.subarray(0, size))) {
    throw new SealError("no header of a sealed payload");
  }
  return { keyId, counter, size };
}

/** @param {FrameKey} key @param {number} counter @param {Uint8Array} associated */
function gcm(key, counter, associated) {
  const iv = key.salt.slice();
  for (let i = 11, rest = counter; rest; i--, rest = Math.floor(rest / 256)) iv[i] ^= rest % 256;
  return { name: "AES-GCM", iv, additionalData: joined(associated) };
}

/** @param {Frame} frame @param {FrameKey} key @param {number} counter @param {boolean} isFace @returns {Promise<Bytes>} */
export async function seal(frame, key, counter, isFace) {
  const padding = isFace ? [0x80, ...new Array(FACE_BYTES - 1 - (frame.payload.length % FACE_BYTES)).fill(0)] : [];
  const header = encodeSealHeader(key.id, counter);
  const associated = joined(header, encodeHeader(frame, 0));
  const sealed = await subtle.encrypt(gcm(key, counter, associated), key.cipher, joined(frame.payload, padding));
  return joined(header, new Uint8Array(sealed));
}

/** @param {Frame} frame @param {FrameKey} key @param {boolean} isFace @returns {Promise<Uint8Array>} */
export async function open(frame, key, isFace) {
  const { counter, size } = decodeSealHeader(frame.payload);
  const associated = joined(frame.payload.subarray(0, size), encodeHeader(frame, 0));
  let opened;
  try {
    opened = new Uint8Array(await subtle.decrypt(gcm(key, counter, associated), key.cipher, joined(frame.payload.subarray(size))));
  } catch {
    throw new SealError("the tag does not fit");
  }
  if (!isFace) return opened;
  const end = opened.findLastIndex((byte) => byte !== 0);
  if (opened[end] !== 0x80) throw new SealError("a face without the mark of its padding");
  return opened.subarray(0, end);
}

/** Lets every counter through once, in any order within the window. */
class ReplayWindow {
  /** @param {number} first */
  constructor(first) {
    this.first = first;
    this.highest = first - 1;
    /** @type {Set<number>} */
    this.seen = new Set();
  }

  /** @param {number} counter */
  isNew(counter) {
    return counter >= this.first && counter > this.highest - WINDOW && !this.seen.has(counter);
  }

  /** @param {number} counter */
  mark(counter) {
    this.seen.add(counter);
    this.highest = Math.max(this.highest, counter);
    for (const each of this.seen) if (each <= this.highest - WINDOW) this.seen.delete(each);
  }
}

// Key messages

/** What a peer says of itself. @param {string} room @param {string} name @param {Track[]} tracks @returns {Promise<Bytes>} */
export async function describe(room, name, tracks) {
  const texts = ["pica seal peer", room, name, ...tracks.flatMap((track) =>
    [track.kind, track.policy, track.avatar, String(track.stream), String(track.deadline_ms)])];
  const encoded = texts.map((text) => utf8.encode(text));
  const data = joined(...encoded.flatMap((text) => [[text.length >> 8, text.length & 255], text]));
  return new Uint8Array(await subtle.digest("SHA-256", data));
}

/** @param {Bytes} key @param {[string, string]} way Ids of sender and receiver. @param {Uint8Array} data */
async function mac(key, [sender, receiver], data) {
  const hmac = await subtle.importKey("raw", key, { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  const whole = await subtle.sign("HMAC", hmac, joined(sender, [0], receiver, [0], data));
  return new Uint8Array(whole, 0, CODE_BYTES).slice();
}

/** @param {Bytes} pairKey @param {[string, string]} way @param {Uint8Array} body @param {"encrypt" | "decrypt"} use */
async function wrapping(pairKey, way, body, use) {
  return aes(await mac(pairKey, way, body), use);
}

const ZERO_NONCE = { name: "AES-GCM", iv: new Uint8Array(12) };

/** What we know of the keys of one peer. */
class PeerKeys {
  /** @param {Peer} peer @param {Bytes} description @param {number} now */
  constructor(peer, description, now) {
    this.peer = peer;
    this.description = description;
    this.challenge = crypto.getRandomValues(new Uint8Array(8));
    this.cameS = now;
    /** @type {number | null} */
    this.dueS = now;
    this.waitS = FIRST_WAIT_S;
    /** @type {SealState} */
    this.state = "waiting";
    /** @type {Bytes} */
    this.publicKey = NOTHING;
    /** @type {Bytes} */
    this.pairKey = NOTHING;
    /** @type {Bytes} */
    this.itsChallenge = new Uint8Array(8);
    this.given = this.first = this.acknowledged = this.newest = 0;
    /** @type {Map<number, {key: FrameKey, window: ReplayWindow, expiresS: number}>} */
    this.keys = new Map();
  }

  /** @param {number} now */
  sayMore(now) {
    this.dueS = now;
    this.waitS = FIRST_WAIT_S;
  }

  /** @param {number} generation Of our key. */
  isContent(generation) {
    return this.state === "verified" && this.acknowledged === generation;
  }
}

/**
 * Stands between the link and the call. Its methods must not run side by side: the call awaits one
 * before the next.
 */
export class Guard {
  /**
   * @param {Uint8Array} secret Of the room, 32 bytes.
   * @param {(peerId: string, data: Uint8Array) => void} whisper
   */
  constructor(secret, whisper) {
    this.secret = secret;
    this.whisper = whisper;
    /** @type {Map<string, PeerKeys>} */
    this.peers = new Map();
    /** @type {Map<number, [string, string]>} */
    this.streams = new Map();
    /** @type {Map<number, string>} */
    this.kinds = new Map();
    this.generation = 0;
    this.counter = 0;
    this.madeS = 0;
    /** @type {FrameKey | null} */
    this.key = null;
    this.budget = MESSAGES_AT_ONCE;
    this.budgetS = 0;
    this.code = "";
    this.codeOf = "";
  }

  /** @param {string} room @param {string} name As the others see it. */
  async begin(room, name) {
    this.room = room;
    this.name = name;
    this.codeKey = await hkdf(this.secret, NOTHING, joined("pica seal code ", room), 32);
    this.pairSalt = await hkdf(this.secret, NOTHING, joined("pica seal pair ", room), 32);
  }

  /** Take a message of the relay; true: it is for the call, too. @param {Message} message @param {number} now */
  async receive(message, now) {
    const { type, peer_id: id } = message;
    if (type === "joined") await this.enter(message, now);
    else if (type === "peer_joined") await this.add(message.peer, now);
    else if (type === "peer_left") await this.remove(id, now);
    else if (type === "peer_back" && this.peers.has(id)) await this.add(/** @type {PeerKeys} */ (this.peers.get(id)).peer, now);
    else if (type === "whisper") {
      await this.receiveKeys(id, message.data, now).catch((error) => {
        if (!(error instanceof SealError)) throw error;
      });
    }
    return type !== "whisper";
  }

  /** @param {Message} joined_ @param {number} now */
  async enter({ peer_id: id, tracks, peers }, now) {
    this.peers.clear();
    this.streams.clear();
    this.ownId = id;
    this.kinds = new Map(tracks.map((/** @type {Track} */ track) => [track.stream, track.kind]));
    this.description = await describe(this.room ?? "", this.name ?? "", tracks);
    const pair = /** @type {CryptoKeyPair} */ (await subtle.generateKey("X25519", true, ["deriveBits"]));
    this.privateKey = pair.privateKey;
    this.publicKey = new Uint8Array(await subtle.exportKey("raw", pair.publicKey));
    await this.changeKey(now);
    for (const peer of peers) await this.add(peer, now);
  }

  /** @param {Peer} peer @param {number} now */
  async add(peer, now) {
    await this.remove(peer.peer_id, now);
    const added = new PeerKeys(peer, await describe(this.room ?? "", peer.name, peer.tracks), now);
    this.peers.set(peer.peer_id, added);
    for (const track of peer.tracks) this.streams.set(track.stream, [peer.peer_id, track.kind]);
    return added;
  }

  /** @param {string} id @param {number} now */
  async remove(id, now) {
    const peer = this.peers.get(id);
    this.peers.delete(id);
    if (peer?.given === this.generation) await this.changeKey(now);
  }

  /** @param {number} now */
  async changeKey(now) {
    this.generation += 1;
    this.baseKey = crypto.getRandomValues(new Uint8Array(16));
    this.key = await deriveKey(this.baseKey, this.generation % KEY_IDS, "encrypt");
    this.madeS = now;
    this.counter = 0;
    for (const peer of this.peers.values()) {
      if (!peer.publicKey.length) continue;
      peer.first = 0;
      peer.sayMore(now);
    }
  }

  /** Whisper what is due: before the frames that need it. @param {number} now */
  async tick(now) {
    this.budget = Math.min(MESSAGES_AT_ONCE, this.budget + (now - this.budgetS) * MESSAGES_PER_S);
    this.budgetS = now;
    const due = [...this.peers.values()].filter((peer) => peer.dueS !== null && peer.dueS <= now);
    for (const peer of due.slice(0, Math.floor(this.budget))) {
      this.budget -= 1;
      this.whisper(peer.peer.peer_id, await this.keyMessage(peer));
      const isContent = peer.isContent(this.generation);
      peer.dueS = isContent ? null : now + peer.waitS;
      peer.waitS = isContent ? FIRST_WAIT_S : Math.min(2 * peer.waitS, LONGEST_WAIT_S);
    }
    for (const peer of this.peers.values()) {
      const isSilent = !peer.publicKey.length && now - peer.cameS >= SILENT_S;
      if (isSilent && peer.state === "waiting") peer.state = "plain";
    }
    await this.updateCode();
  }

  /** @param {PeerKeys} peer */
  async keyMessage(peer) {
    peer.given = peer.publicKey.length ? this.generation : 0;
    const numbers = new DataView(new ArrayBuffer(12));
    [peer.newest, peer.given, peer.first].forEach((value, i) => numbers.setUint32(4 * i, value));
    const body = joined([peer.waitS > FIRST_WAIT_S ? 1 : 0], this.publicKey ?? [], peer.challenge,
      peer.itsChallenge, new Uint8Array(numbers.buffer), this.description ?? []);
    const way = /** @type {[string, string]} */ ([this.ownId ?? "", peer.peer.peer_id]);
    let wrapped = new Uint8Array(WRAPPED_BYTES);
    if (peer.given) {
      const key = await wrapping(peer.pairKey, way, body, "encrypt");
      wrapped = new Uint8Array(await subtle.encrypt(ZERO_NONCE, key, joined(this.baseKey ?? [])));
    }
    const said = joined(body, wrapped);
    return joined(said, await mac(this.codeKey ?? NOTHING, way, said));
  }

  /** @param {string} id @param {Bytes} data @param {number} now */
  async receiveKeys(id, data, now) {
    let peer = this.peers.get(id);
    if (peer === undefined) throw new SealError("not from a member of the room");
    const way = /** @type {[string, string]} */ ([id, this.ownId ?? ""]);
    const said = data.subarray(0, -CODE_BYTES);
    const isOurs = data.length === MESSAGE_BYTES
      && equal(await mac(this.codeKey ?? NOTHING, way, said), data.subarray(-CODE_BYTES));
    const isRelabelled = isOurs && !equal(data.subarray(61, BODY_BYTES), peer.description);
    if (peer.state !== "verified") {
      peer.state = !isOurs ? "secret differs" : isRelabelled ? "relabelled" : "waiting";
    }
    if (!isOurs || isRelabelled) throw new SealError("not by this peer with the secret of this room");
    const publicKey = data.slice(1, 33);
    const challenge = data.slice(33, 41);
    let isLive = equal(data.subarray(41, 49), peer.challenge);
    if (!equal(publicKey, peer.publicKey) && (isLive || !peer.publicKey.length)) {
      if (peer.publicKey.length) { // it began again, and the relay did not say so
        peer = await this.add(peer.peer, now);
        isLive = false;
      }
      await this.meet(peer, publicKey, now);
    }
    if (!equal(challenge, peer.itsChallenge)) {
      peer.itsChallenge = challenge;
      peer.first = this.counter;
      peer.acknowledged = 0;
      peer.sayMore(now);
    }
    const view = new DataView(data.buffer, data.byteOffset, data.length);
    if (isLive) {
      peer.acknowledged = Math.max(peer.acknowledged, Math.min(view.getUint32(49), this.generation));
      const generation = view.getUint32(53);
      if (generation > peer.newest) await this.takeKey(peer, way, data, generation, view.getUint32(57), now);
    }
    if (data[0]) peer.dueS = now;
    else if (peer.isContent(this.generation) && (peer.dueS ?? 0) > now) peer.dueS = null;
  }

  /** Learn a public key: from now on the peer can be given ours. @param {PeerKeys} peer @param {Bytes} publicKey @param {number} now */
  async meet(peer, publicKey, now) {
    const known = [this.publicKey ?? NOTHING, ...[...this.peers.values()].map((each) => each.publicKey)];
    if (known.some((each) => equal(each, publicKey))) throw new SealError("a key of another member");
    const theirs = await subtle.importKey("raw", publicKey, "X25519", false, []);
    let shared;
    try {
      shared = await subtle.deriveBits({ name: "X25519", public: theirs }, /** @type {CryptoKey} */ (this.privateKey), 256);
    } catch {
      throw new SealError("a public key that agrees on nothing");
    }
    const keys = [this.publicKey ?? NOTHING, publicKey].sort(compare);
    peer.pairKey = await hkdf(new Uint8Array(shared), this.pairSalt ?? NOTHING, joined("pica seal wrap ", ...keys), 32);
    peer.publicKey = publicKey;
    if (this.counter && now - this.madeS >= YOUNG_KEY_S) await this.changeKey(now);
  }

  /** @param {PeerKeys} peer @param {[string, string]} way @param {Bytes} data @param {number} generation @param {number} first @param {number} now */
  async takeKey(peer, way, data, generation, first, now) {
    const cipher = await wrapping(peer.pairKey, way, data.subarray(0, BODY_BYTES), "decrypt");
    let baseKey;
    try {
      baseKey = new Uint8Array(await subtle.decrypt(ZERO_NONCE, cipher, data.slice(BODY_BYTES, -CODE_BYTES)));
    } catch {
      throw new SealError("a key that is wrapped for another peer");
    }
    for (const [id, known] of peer.keys) {
      if (known.expiresS <= now) peer.keys.delete(id);
      known.expiresS = Math.min(known.expiresS, now + LATE_FRAMES_S);
    }
    const key = await deriveKey(baseKey, generation % KEY_IDS, "decrypt");
    peer.keys.set(key.id, { key, window: new ReplayWindow(first), expiresS: Infinity });
    peer.newest = generation;
    peer.state = "verified";
    peer.sayMore(now);
  }

  /** The thirty digits; empty while no other member can read us. */
  async updateCode() {
    const given = [...this.peers.values()].filter((peer) => peer.given);
    const members = [joined(this.publicKey ?? [], this.description ?? []),
      ...given.map((peer) => joined(peer.publicKey, peer.description))];
    const text = joined(...members.sort(compare));
    if (String(text) === this.codeOf) return;
    this.codeOf = String(text);
    const key = await subtle.importKey("raw", text, "PBKDF2", false, ["deriveBits"]);
    const salt = joined("pica seal code ", this.room ?? "");
    const bits = await subtle.deriveBits({ name: "PBKDF2", hash: "SHA-512", salt, iterations: CODE_ROUNDS }, key, 240);
    const digest = new Uint8Array(bits);
    const groups = [0, 5, 10, 15, 20, 25].map((at) =>
      digest.subarray(at, at + 5).reduce((all, byte) => all * 256 + byte, 0) % 100_000);
    this.code = given.length ? groups.map((group) => String(group).padStart(5, "0")).join(" ") : "";
  }

  /** @param {Frame} frame Of ours; @returns {Promise<Frame>} */
  async seal(frame, /** @type {number} */ now) {
    if (this.counter >= FRAMES_PER_KEY) await this.changeKey(now);
    if (this.key === null) throw new SealError("there is no key to seal with: not in a room");
    const isFace = this.kinds.get(frame.stream) === "face";
    return { ...frame, payload: await seal(frame, this.key, this.counter++, isFace) };
  }

  /** The frame in plain; null: it does not open, and no plain one is taken. @param {Frame} frame @param {number} now @returns {Promise<Frame | null>} */
  async open(frame, now) {
    const [owner, kind] = this.streams.get(frame.stream) ?? ["", ""];
    try {
      const { keyId, counter } = decodeSealHeader(frame.payload);
      const known = this.peers.get(owner)?.keys.get(keyId);
      if (known === undefined || known.expiresS <= now || !known.window.isNew(counter)) return null;
      const payload = await open(frame, known.key, kind === "face");
      known.window.mark(counter);
      return { ...frame, payload };
    } catch (error) {
      if (!(error instanceof SealError)) throw error;
      return null;
    }
  }
}

/** The room secret in the text of its file, or of a link; throws a `SealError`. @param {string} text @returns {Bytes} */
export function readSecret(text) {
  const found = /^(?:pica-secret-1:)?([A-Za-z0-9_-]{43})=?\s*$/.exec(text);
  if (found === null) throw new SealError("the link's secret is no room secret");
  return Uint8Array.from(atob(found[1].replaceAll("-", "+").replaceAll("_", "/")), (char) => char.charCodeAt(0));
}
