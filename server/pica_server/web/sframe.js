/**
 * Payloads sealed end to end in the manner of SFrame (RFC 9605), and the keys for it, by WebCrypto.
 * Formats and rules are those of docs/privacy.md; `pica_client.e2ee` is the Python side.
 */

import { encodeHeader, fromBase64 } from "./wire.js";

const { subtle } = crypto;
const FACE_BYTES = 48;
const WINDOW = 1024;
const KEY_IDS = 8;
/** Of a key message: all, what is said in plain, and the code that proves who says it. */
const [MESSAGE_BYTES, BODY_BYTES, CODE_BYTES] = [141, 93, 16];
const FRAMES_PER_KEY = 65_536;
const [YOUNG_KEY_S, LATE_FRAMES_S] = [1, 2];
const [FIRST_WAIT_S, LONGEST_WAIT_S, SILENT_S] = [0.25, 8, 3];
const [MESSAGES_PER_S, MESSAGES_AT_ONCE] = [12, 96];
const CODE_ROUNDS = 5000;
const NOTHING = new Uint8Array();
const ZERO_NONCE = { name: "AES-GCM", iv: new Uint8Array(12) };
const utf8 = new TextEncoder();

/** What does not open, or is no key message. */
export class SealError extends Error {}

/** @param {(string | Uint8Array | number[])[]} parts @returns {Bytes} */
const joined = (...parts) =>
  Uint8Array.from(
    parts.flatMap((part) => [...(typeof part === "string" ? utf8.encode(part) : part)]));
/** @param {Uint8Array} one @param {Uint8Array} other */
const equal = (one, other) => one.length === other.length
  && one.every((byte, i) => byte === other[i]);

/** @type {(one: Uint8Array, other: Uint8Array) => number} */
const compare = (one, other) => one.reduce((order, byte, i) => order || byte - other[i], 0);

/** @type {(secret: Bytes, salt: Bytes, info: Bytes, size: number) => Promise<Bytes>} */
async function hkdf(secret, salt, info, size) {
  const key = await subtle.importKey("raw", secret, "HKDF", false, ["deriveBits"]);
  return new Uint8Array(
    await subtle.deriveBits({ name: "HKDF", hash: "SHA-256", salt, info }, key, 8 * size));
}

/** @param {Bytes} key @param {"encrypt" | "decrypt"} use */
const aes = (key, use) => subtle.importKey("raw", key, "AES-GCM", false, [use]);

/** Decrypt, or say why it cannot be.
 * @type {(how: AesGcmParams, key: CryptoKey, data: Bytes, problem: string) => Promise<Bytes>} */
async function decrypted(how, key, data, problem) {
  try {
    return new Uint8Array(await subtle.decrypt(how, key, data));
  } catch {
    throw new SealError(problem);
  }
}

// One payload

/** @type {(baseKey: Bytes, id: number, use: "encrypt" | "decrypt") => Promise<FrameKey>} */
export async function deriveKey(baseKey, id, use) {
  const suffix = [0, 0, 0, 0, 0, 0, 0, id, 0, 4];
  const key = await hkdf(baseKey, NOTHING, joined("SFrame 1.0 Secret key ", suffix), 16);
  const salt = await hkdf(baseKey, NOTHING, joined("SFrame 1.0 Secret salt ", suffix), 12);
  return { id, cipher: await aes(key, use), salt };
}

/** @param {number} keyId Below 8. @param {number} counter */
function encodeSealHeader(keyId, counter) {
  if (counter < 8) return [(keyId << 4) | counter];
  const tail = [];
  for (let rest = counter; rest; rest = Math.floor(rest / 256)) tail.unshift(rest % 256);
  return [(keyId << 4) | 8 | (tail.length - 1), ...tail];
}

/** @param {Uint8Array} sealed */
function decodeSealHeader(sealed) {
  const [config = 128] = sealed;
  const size = config & 8 ? 2 + (config & 7) : 1;
  const counter = size === 1 ? config & 7 : sealed.subarray(1, size)
    .reduce((all, byte) => all * 256 + byte, 0);
  const keyId = config >> 4;
  const isKnown = keyId < KEY_IDS && Number.isSafeInteger(counter);
  if (!isKnown || !equal(joined(encodeSealHeader(keyId, counter)), sealed.subarray(0, size))) {
    throw new SealError("no header of a sealed payload");
  }
  return { keyId, counter, size };
}

/** @param {FrameKey} key @param {number} counter @param {Uint8Array} header @param {Frame} frame */
function gcm(key, counter, header, frame) {
  const iv = key.salt.slice();
  for (let i = 11, rest = counter; rest; i--, rest = Math.floor(rest / 256)) iv[i] ^= rest % 256;
  return { name: "AES-GCM", iv, additionalData: joined(header, encodeHeader(frame, 0)) };
}

/** @param {Frame} frame @param {FrameKey} key @param {number} counter @param {boolean} isFace */
export async function seal(frame, key, counter, isFace) {
  const padding = isFace
    ? [0x80, ...new Array(FACE_BYTES - 1 - (frame.payload.length % FACE_BYTES)).fill(0)] : [];
  const header = joined(encodeSealHeader(key.id, counter));
  const sealed = await subtle.encrypt(gcm(key, counter, header, frame), key.cipher,
    joined(frame.payload, padding));
  return joined(header, new Uint8Array(sealed));
}

/** @param {Frame} frame @param {FrameKey} key @param {boolean} isFace */
export async function open(frame, key, isFace) {
  const { counter, size } = decodeSealHeader(frame.payload);
  const how = gcm(key, counter, frame.payload.subarray(0, size), frame);
  const opened =
    await decrypted(how, key.cipher, joined(frame.payload.subarray(size)), "the tag does not fit");
  if (!isFace) return opened;
  const end = opened.findLastIndex((byte) => byte !== 0);
  if (opened[end] !== 0x80) throw new SealError("a face without the mark of its padding");
  return opened.subarray(0, end);
}

// Key messages

/** What a peer says of itself. @param {string} room @param {string} name @param {Track[]} tracks */
export async function describe(room, name, tracks) {
  const texts = ["pica seal peer", room, name, ...tracks.flatMap((track) =>
    [track.kind, track.avatar, String(track.stream), String(track.deadline_ms)])];
  const data = joined(...texts.map((text) => utf8.encode(text))
    .flatMap((text) => [[text.length >> 8, text.length & 255], text]));
  return new Uint8Array(await subtle.digest("SHA-256", data));
}

/** @param {Bytes} key @param {Way} way @param {Uint8Array} data */
async function mac(key, [sender, receiver], data) {
  const hmac =
    await subtle.importKey("raw", key, { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  const whole = await subtle.sign("HMAC", hmac, joined(sender, [0], receiver, [0], data));
  return new Uint8Array(whole, 0, CODE_BYTES).slice();
}

/** What we know of the keys of one peer. */
class PeerKeys {
  challenge = crypto.getRandomValues(new Uint8Array(8));
  itsChallenge = new Uint8Array(8);
  waitS = FIRST_WAIT_S;
  /** @type {SealState} */
  state = "waiting";
  publicKey = NOTHING;
  pairKey = NOTHING;
  /** Generations of our key: given to it, and that it has; of its key: that we have. */
  given = 0;
  acknowledged = 0;
  newest = 0;
  /** The counter of the first frame of ours that it may open. */
  first = 0;
  /** @type {Map<number, {key: FrameKey, first: number, seen: Set<number>, expiresS: number}>} */
  keys = new Map();

  /** @param {Peer} peer @param {Bytes} description @param {number} now */
  constructor(peer, description, now) {
    this.peer = peer;
    this.description = description;
    this.cameS = now;
    this.dueS = now;
  }

  /** @param {number} now */
  sayMore(now) {
    this.dueS = now;
    this.waitS = FIRST_WAIT_S;
  }
}

/**
 * Stands between the link and the call. Its methods must not run side by side: the call awaits one
 * before the next.
 */
export class Guard {
  /** @type {Map<string, PeerKeys>} */
  peers = new Map();
  room = "";
  name = "";
  ownId = "";
  codeKey = NOTHING;
  pairSalt = NOTHING;
  description = NOTHING;
  publicKey = NOTHING;
  /** @type {CryptoKey | null} */
  privateKey = null;
  baseKey = NOTHING;
  /** @type {FrameKey | null} */
  key = null;
  generation = 0;
  counter = 0;
  madeS = 0;
  budget = MESSAGES_AT_ONCE;
  budgetS = 0;
  /** Thirty digits to read aloud; empty while no other member can read us. */
  code = "";
  codeOf = "";

  /** @param {Bytes} secret Of the room, 32 bytes.
   * @param {(peerId: string, data: Bytes) => void} whisper */
  constructor(secret, whisper) {
    this.secret = secret;
    this.whisper = whisper;
  }

  /** @param {string} room @param {string} name As the others see it. */
  async begin(room, name) {
    this.room = room;
    this.name = name;
    this.codeKey = await hkdf(this.secret, NOTHING, joined("pica seal code ", room), 32);
    this.pairSalt = await hkdf(this.secret, NOTHING, joined("pica seal pair ", room), 32);
  }

  /** Take a message of the relay. @param {Message} message @param {number} now */
  async receive(message, now) {
    const { type, peer_id: id } = message;
    const known = this.peers.get(id);
    if (type === "joined") await this.enter(message, now);
    else if (type === "peer_joined") await this.add(message.peer, now);
    else if (type === "peer_left") await this.remove(id, now);
    else if (type === "peer_away" && known && !message.is_away) await this.add(known.peer, now);
    else if (type === "whisper" && known) {
      await this.receiveKeys(known, message.data, now).catch((error) => {
        if (!(error instanceof SealError)) throw error;
      });
    }
  }

  /** @param {Message} joined_ @param {number} now */
  async enter({ peer_id: id, tracks, peers }, now) {
    this.peers.clear();
    this.ownId = id;
    this.description = await describe(this.room, this.name, tracks);
    const pair =
      /** @type {CryptoKeyPair} */ (await subtle.generateKey("X25519", true, ["deriveBits"]));
    this.privateKey = pair.privateKey;
    this.publicKey = new Uint8Array(await subtle.exportKey("raw", pair.publicKey));
    await this.changeKey(now);
    for (const peer of peers) await this.add(peer, now);
  }

  /** @param {Peer} peer @param {number} now */
  async add(peer, now) {
    await this.remove(peer.peer_id, now);
    const added = new PeerKeys(peer, await describe(this.room, peer.name, peer.tracks), now);
    this.peers.set(peer.peer_id, added);
    return added;
  }

  /** @param {string} id @param {number} now */
  async remove(id, now) {
    const given = this.peers.get(id)?.given;
    this.peers.delete(id);
    if (given === this.generation) await this.changeKey(now);
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

  /** Whether a peer has our key, and we have its. @param {PeerKeys} peer */
  isDone({ state, acknowledged }) {
    return state === "verified" && acknowledged === this.generation;
  }

  /** Whisper what is due: before the frames that need it. @param {number} now */
  async tick(now) {
    this.budget = Math.min(MESSAGES_AT_ONCE, this.budget + (now - this.budgetS) * MESSAGES_PER_S);
    this.budgetS = now;
    const due = [...this.peers.values()].filter(({ dueS }) => dueS <= now);
    for (const peer of due.slice(0, Math.floor(this.budget))) {
      this.budget -= 1;
      this.whisper(peer.peer.peer_id, await this.keyMessage(peer));
      const isDone = this.isDone(peer);
      peer.dueS = isDone ? Infinity : now + peer.waitS;
      peer.waitS = isDone ? FIRST_WAIT_S : Math.min(2 * peer.waitS, LONGEST_WAIT_S);
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
    const body = joined([peer.waitS > FIRST_WAIT_S ? 1 : 0], this.publicKey, peer.challenge,
      peer.itsChallenge, new Uint8Array(numbers.buffer), this.description);
    /** @type {Way} */
    const way = [this.ownId, peer.peer.peer_id];
    let wrapped = new Uint8Array(MESSAGE_BYTES - BODY_BYTES - CODE_BYTES);
    if (peer.given) {
      const cipher = await aes(await mac(peer.pairKey, way, body), "encrypt");
      wrapped = new Uint8Array(await subtle.encrypt(ZERO_NONCE, cipher, this.baseKey));
    }
    const said = joined(body, wrapped);
    return joined(said, await mac(this.codeKey, way, said));
  }

  /** @param {PeerKeys} known @param {Bytes} data @param {number} now */
  async receiveKeys(known, data, now) {
    let peer = known;
    /** @type {Way} */
    const way = [peer.peer.peer_id, this.ownId];
    const said = data.subarray(0, -CODE_BYTES);
    const isOurs = data.length === MESSAGE_BYTES
      && equal(await mac(this.codeKey, way, said), data.subarray(-CODE_BYTES));
    const isRelabelled = isOurs && !equal(data.subarray(61, BODY_BYTES), peer.description);
    if (peer.state !== "verified") {
      peer.state = !isOurs ? "secret differs" : isRelabelled ? "relabelled" : "waiting";
    }
    if (!isOurs || isRelabelled) {
      throw new SealError("not by this peer with the secret of this room");
    }
    const [publicKey, challenge] = [data.slice(1, 33), data.slice(33, 41)];
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
    if (isLive) {
      const view = new DataView(data.buffer, data.byteOffset, data.length);
      const [acknowledged, generation, first] = [49, 53, 57].map((at) => view.getUint32(at));
      peer.acknowledged = Math.max(peer.acknowledged, Math.min(acknowledged, this.generation));
      if (generation > peer.newest) await this.takeKey(peer, way, data, generation, first, now);
    }
    if (data[0]) peer.dueS = now;
    else if (this.isDone(peer) && peer.dueS > now) peer.dueS = Infinity;
  }

  /** Learn a public key: from now on the peer can be given ours.
   * @type {(peer: PeerKeys, publicKey: Bytes, now: number) => Promise<void>} */
  async meet(peer, publicKey, now) {
    const known = [this.publicKey, ...Array.from(this.peers.values(), (each) => each.publicKey)];
    if (known.some((each) => equal(each, publicKey))) {
      throw new SealError("a key of another member");
    }
    const theirs = await subtle.importKey("raw", publicKey, "X25519", false, []);
    const ours = /** @type {CryptoKey} */ (this.privateKey);
    const shared = await subtle.deriveBits({ name: "X25519", public: theirs }, ours, 256)
      .catch(() => NOTHING);
    if (!shared.byteLength) throw new SealError("a public key that agrees on nothing");
    const keys = [this.publicKey, publicKey].sort(compare);
    peer.pairKey =
      await hkdf(new Uint8Array(shared), this.pairSalt, joined("pica seal wrap ", ...keys), 32);
    peer.publicKey = publicKey;
    if (this.counter && now - this.madeS >= YOUNG_KEY_S) await this.changeKey(now);
  }

  /** @type {(peer: PeerKeys, way: Way, data: Bytes, generation: number, first: number, now: number)
   * => Promise<void>} */
  async takeKey(peer, way, data, generation, first, now) {
    const cipher = await aes(await mac(peer.pairKey, way, data.subarray(0, BODY_BYTES)), "decrypt");
    const wrapped = data.slice(BODY_BYTES, -CODE_BYTES);
    const baseKey =
      await decrypted(ZERO_NONCE, cipher, wrapped, "a key that is wrapped for another peer");
    for (const [id, known] of peer.keys) {
      if (known.expiresS <= now) peer.keys.delete(id);
      known.expiresS = Math.min(known.expiresS, now + LATE_FRAMES_S);
    }
    const key = await deriveKey(baseKey, generation % KEY_IDS, "decrypt");
    peer.keys.set(key.id, { key, first, seen: new Set(), expiresS: Infinity });
    peer.newest = generation;
    peer.state = "verified";
    peer.sayMore(now);
  }

  async updateCode() {
    const given = [...this.peers.values()].filter((peer) => peer.given);
    const members =
      [this, ...given].map(({ publicKey, description }) => joined(publicKey, description));
    const text = joined(...members.sort(compare));
    if (String(text) === this.codeOf) return;
    this.codeOf = String(text);
    const key = await subtle.importKey("raw", text, "PBKDF2", false, ["deriveBits"]);
    const salt = joined("pica seal code ", this.room);
    const how = { name: "PBKDF2", hash: "SHA-512", salt, iterations: CODE_ROUNDS };
    const digest = new Uint8Array(await subtle.deriveBits(how, key, 240));
    const groups = [0, 5, 10, 15, 20, 25].map((at) =>
      digest.subarray(at, at + 5).reduce((all, byte) => all * 256 + byte, 0) % 100_000);
    this.code = given.length ? groups.map((group) => String(group).padStart(5, "0")).join(" ") : "";
  }

  /** Seal a frame of ours.
   * @type {(frame: Frame, isFace: boolean, now: number) => Promise<Frame>} */
  async seal(frame, isFace, now) {
    if (this.counter >= FRAMES_PER_KEY) await this.changeKey(now);
    if (this.key === null) throw new SealError("there is no key to seal with: not in a room");
    return { ...frame, payload: await seal(frame, this.key, this.counter++, isFace) };
  }

  /** A member's frame in plain; null: it does not open, and no plain one is taken.
   * @type {(frame: Frame, owner: string, isFace: boolean, now: number) => Promise<Frame | null>} */
  async open(frame, owner, isFace, now) {
    try {
      const { keyId, counter } = decodeSealHeader(frame.payload);
      const known = this.peers.get(owner)?.keys.get(keyId);
      if (!known || known.expiresS <= now) return null;
      // Every counter comes through once, in any order within the window.
      const oldest = Math.max(...known.seen) - WINDOW;
      if (counter < known.first || counter <= oldest || known.seen.has(counter)) return null;
      const payload = await open(frame, known.key, isFace);
      known.seen.add(counter);
      for (const each of known.seen) if (each <= counter - WINDOW) known.seen.delete(each);
      return { ...frame, payload };
    } catch (error) {
      if (!(error instanceof SealError)) throw error;
      return null;
    }
  }
}

/** The room secret in the text of its file, or of a link; throws a `SealError`.
 * @param {string} text @returns {Bytes} */
export function readSecret(text) {
  const found = /^(?:pica-secret-1:)?([A-Za-z0-9_-]{43})=?\s*$/.exec(text);
  if (found === null) throw new SealError("the link's secret is no room secret");
  return fromBase64(found[1]);
}
