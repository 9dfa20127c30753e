/**
 * The way to the relay: one websocket after the other, each of which joins the room, at best in the
 * place of the last one. It says what happens in events, and takes frames while it is joined.
 *
 * @module
 */

import { seconds } from "./clock.js";
import {
  CONTROL_KIND, MEDIA_KIND, SUBPROTOCOL, WireError, decodeMedia, decodeMessage, encodeFrame,
  encodeMessage,
} from "./wire.js";

/** @import { Frame, Message, Peer, Track } from "./wire.js" */

const HANDSHAKE_S = 5;
const FIRST_WAIT_S = 0.25;
const LONGEST_WAIT_S = 8;
/** A connection that held for so long starts the waits again. */
const SETTLED_S = 5;
/** How long one who was in the room is refused before that is final. */
const RETURN_S = 60;
const TELL_INTERVAL_S = 1;
/** What waits in the socket beyond it is old before it leaves: faces and voices are left out. */
const MAX_WAITING_BYTES = { latest: 1000, ordered: 4000 };
/** Codes after which one tries again; and those that may pass within `RETURN_S`. */
const AGAIN = [1001, 1005, 1006, 1011, 1012, 4003, 4005, 4007, 4009];
const MAY_PASS = [4004, 4010, 4011];

/**
 * @typedef {object} Handler Where everything goes that a link hears.
 * @property {(message: Message) => void} message One of the relay's, in the room.
 * @property {(frame: Frame) => void} frame
 * @property {(state: "joining" | "reconnecting" | "ended", reason: string) => void} left
 */

export class Link {
  /**
   * @param {string} url Of the relay, ws:// or wss://.
   * @param {{room: string, name: string, token: string, tracks: Track[]}} join
   * @param {Handler} handler
   */
  constructor(url, join, handler) {
    this.url = url;
    this.join = join;
    this.handler = handler;
    /** @type {Record<string, string>} */
    this.metadata = {};
    /** @type {Track[]} */
    this.tracks = join.tracks;
    this.peerId = "";
    /** @type {number[]} */
    this.sequences = join.tracks.map(() => 0);
    /** @type {Set<number>} */
    this.mutedStreams = new Set();
    /** @type {WebSocket | null} */
    this.socket = null;
    this.isJoined = false;
    this.hasJoined = false;
    this.resume = "";
    this.waitS = FIRST_WAIT_S;
    this.refusedSinceS = 0;
    this.joinedS = 0;
    this.toldS = 0;
    this.isTelling = false;
    /** @type {Map<string, Peer>} */
    this.peers = new Map();
    /** Newest capture time of each peer, and when it came. @type {Map<string, [number, number]>} */
    this.clocks = new Map();
    /** @type {Map<number, string>} */
    this.publishers = new Map();
  }

  /** Connect, and come back until `leave`. */
  connect() {
    const socket = new WebSocket(this.url, [SUBPROTOCOL]);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    let ending = { code: 0, reason: "" };
    const late = setTimeout(() => socket.close(), HANDSHAKE_S * 1000);
    socket.onopen = () => {
      const { room, name, token, tracks } = this.join;
      this.toldS = seconds();
      socket.send(encodeMessage({
        type: "join", room, name, tracks, token, metadata: this.metadata, resumable: true,
        resume: this.resume,
      }));
      this.resume = "";
    };
    socket.onmessage = ({ data }) => {
      try {
        const message = this.receive(data);
        if (message?.type === "joined") clearTimeout(late);
        if (message?.type === "bye") ending = { code: message.code, reason: said(message) };
      } catch (error) {
        if (!(error instanceof WireError)) throw error;
        ending = { code: 4000, reason: `the relay broke the protocol: ${error.message}` };
        socket.close(4000);
      }
    };
    socket.onclose = (event) => {
      clearTimeout(late);
      if (this.socket !== socket) return;
      this.socket = null;
      this.ended(ending.code || event.code, ending.reason || event.reason);
    };
  }

  /** @param {unknown} data @returns {Message | null} */
  receive(data) {
    if (!(data instanceof ArrayBuffer)) throw new WireError("a message of text");
    const bytes = new Uint8Array(data);
    if (bytes[0] === MEDIA_KIND && this.isJoined) {
      const now = seconds();
      for (const frame of decodeMedia(bytes, (stream) => this.expectedUs(stream, now))) {
        const peer = this.publishers.get(frame.stream);
        if (peer === undefined) continue;
        this.clocks.set(peer, [frame.capturedUs, now]);
        this.handler.frame(frame);
      }
      return null;
    }
    if (bytes[0] !== CONTROL_KIND) throw new WireError("a message of an unknown kind");
    const message = decodeMessage(bytes);
    if (message.type === "bye") return message;
    if ((message.type === "joined") === this.isJoined) throw new WireError("an unexpected message");
    this.note(message);
    this.handler.message(message);
    return message;
  }

  /** Keep the list of peers, and refuse a room that has one twice. @param {Message} message */
  note(message) {
    const { type } = message;
    if (type === "joined") {
      const asked = JSON.stringify(this.join.tracks);
      const got = message.tracks.map((/** @type {Track} */ track) => ({ ...track, stream: 0 }));
      if (JSON.stringify(got) !== asked || message.room !== this.join.room) {
        throw new WireError("joined otherwise than asked");
      }
      this.peers = new Map(message.peers.map((/** @type {Peer} */ peer) => [peer.peer_id, peer]));
      if (this.peers.size < message.peers.length) throw new WireError("a peer twice");
      this.peerId = message.peer_id;
      this.tracks = message.tracks;
      this.resume = message.resume;
      if (!message.resumed) this.sequences.fill(0);
      this.mutedStreams.clear();
      this.isJoined = this.hasJoined = true;
      this.joinedS = seconds();
      this.refusedSinceS = 0;
    } else if (type === "peer_joined") {
      if (this.peers.has(message.peer.peer_id)) {
        this.handler.message({ type: "peer_left", peer_id: message.peer.peer_id, reason: "" });
      }
      this.peers.set(message.peer.peer_id, message.peer);
    } else if (type === "peer_left") {
      this.peers.delete(message.peer_id);
    } else if (type === "stream_muted") {
      this.mutedStreams[message.is_muted ? "add" : "delete"](message.stream);
    }
    const all = [...this.peers.values()];
    const streams = all.flatMap((peer) => peer.tracks.map((track) => track.stream));
    const own = this.tracks.map((track) => track.stream);
    if (this.peers.has(this.peerId) || new Set([...streams, ...own]).size < streams.length + own.length) {
      throw new WireError("a peer or a stream twice in a room");
    }
    this.publishers = new Map(all.flatMap((peer) =>
      peer.tracks.map((track) => /** @type {[number, string]} */ ([track.stream, peer.peer_id]))));
    for (const peer of this.clocks.keys()) if (!this.peers.has(peer)) this.clocks.delete(peer);
  }

  /** @param {number} stream @param {number} now @returns {number} About what its clock shows. */
  expectedUs(stream, now) {
    const [capturedUs, atS] = this.clocks.get(this.publishers.get(stream) ?? "") ?? [0, 0];
    return capturedUs + Math.round((now - atS) * 1e6);
  }

  /** @param {number} code @param {string} reason */
  ended(code, reason) {
    const now = seconds();
    const wasJoined = this.isJoined;
    this.isJoined = false;
    if (wasJoined && now - this.joinedS >= SETTLED_S) this.waitS = FIRST_WAIT_S;
    let isFinal = !AGAIN.includes(code);
    if (MAY_PASS.includes(code) && this.hasJoined) {
      this.refusedSinceS ||= now;
      isFinal = now - this.refusedSinceS >= RETURN_S;
    }
    if (isFinal) {
      this.handler.left("ended", reason || `the relay closed the connection (${code})`);
      return;
    }
    this.handler.left(this.hasJoined ? "reconnecting" : "joining", reason || "no answer from the relay");
    // Chance spreads the return of a full room over time.
    this.timer = setTimeout(() => this.connect(), this.waitS * (500 + 500 * Math.random()));
    this.waitS = Math.min(2 * this.waitS, LONGEST_WAIT_S);
  }

  leave() {
    clearTimeout(this.timer);
    const { socket } = this;
    this.socket = null;
    if (this.isJoined) socket?.send(encodeMessage({ type: "bye", code: 1000, reason: "", url: "" }));
    this.isJoined = false;
    socket?.close(1000);
  }

  /** Say something to the relay; false while that cannot be. @param {Message} message */
  tell(message) {
    if (this.isJoined) this.socket?.send(encodeMessage(message));
    return this.isJoined;
  }

  /** Set an entry of our metadata; empty takes it away. @param {string} key @param {string} value */
  describe(key, value) {
    if ((this.metadata[key] ?? "") === value) return;
    const { [key]: _, ...others } = this.metadata;
    this.metadata = value ? { ...others, [key]: value } : others;
    if (this.isTelling) return;
    this.isTelling = true;
    setTimeout(() => {
      this.isTelling = false;
      this.toldS = seconds();
      this.tell({ type: "update_metadata", metadata: this.metadata });
    }, Math.max(this.toldS + TELL_INTERVAL_S - seconds(), 0) * 1000);
  }

  /**
   * Give a frame of one of our tracks its number; null: it is not to be sent.
   *
   * @param {number} place Of the track.
   * @param {Uint8Array} payload
   * @param {number} capturedUs
   * @param {number} [multiple] The number is to be a multiple of it.
   * @returns {Frame | null}
   */
  number(place, payload, capturedUs, multiple = 1) {
    const { policy, stream } = this.tracks[place];
    const limit = policy === "ordered" ? MAX_WAITING_BYTES.ordered : MAX_WAITING_BYTES.latest;
    if (!this.isJoined || (this.socket?.bufferedAmount ?? 0) > limit) return null;
    const next = this.sequences[place];
    const sequence = (Math.ceil(next / multiple) * multiple) % 65_536;
    this.sequences[place] = (sequence + 1) % 65_536;
    return this.mutedStreams.has(stream) ? null : { stream, sequence, capturedUs, payload };
  }

  /** @param {Frame} frame */
  send(frame) {
    if (this.isJoined) this.socket?.send(encodeFrame(frame));
  }
}

/** @param {Message} bye @returns {string} */
function said({ reason, url }) {
  return url ? `the room is at another relay, ${url}: open the link there` : reason;
}
