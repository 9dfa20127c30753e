/**
 * The way to the relay: one websocket after the other, each of which joins the room, at best in the
 * place of the last one.
 */

import { seconds } from "./clock.js";
import {
  CONTROL_KIND, MEDIA_KIND, SUBPROTOCOL, WireError, decodeMedia, decodeMessage, encodeFrame,
  encodeMessage,
} from "./wire.js";

const HANDSHAKE_S = 5;
const [FIRST_WAIT_S, LONGEST_WAIT_S] = [0.25, 8];
/** A connection that held for so long starts the waits again. */
const SETTLED_S = 5;
/** How long one who was in the room is refused before that is final. */
const RETURN_S = 60;
const TELL_INTERVAL_S = 1;
/** What waits in the socket beyond it is old before it leaves: frames are left out. */
const MAX_WAITING_BYTES = { face: 1000, voice: 4000 };
/** Codes after which one tries again; and those that may pass within `RETURN_S`. */
const AGAIN = [1001, 1005, 1006, 1011, 1012, 4003, 4005, 4007, 4009];
const MAY_PASS = [4004, 4010, 4011];

export class Link {
  /** @type {Record<string, string>} */
  metadata = {};
  /** @type {Set<number>} */
  mutedStreams = new Set();
  /** @type {WebSocket | null} */
  socket = null;
  isJoined = false;
  hasJoined = false;
  resume = "";
  waitS = FIRST_WAIT_S;
  refusedSinceS = 0;
  joinedS = 0;
  toldS = 0;
  timer = 0;
  tellTimer = 0;
  /** Who sends each stream. @type {Map<number, string>} */
  publishers = new Map();
  /** Newest capture time of each peer, and when it came. @type {Map<string, [number, number]>} */
  clocks = new Map();

  /** @param {string} url Of the relay, ws:// or wss://. @param {Join} join
   * @param {LinkHandler} handler */
  constructor(url, join, handler) {
    this.url = url;
    this.join = join;
    this.handler = handler;
    this.tracks = join.tracks;
    this.sequences = join.tracks.map(() => 0);
  }

  /** Connect, and come back until `leave`. */
  connect() {
    const socket = new WebSocket(this.url, [SUBPROTOCOL]);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    let [code, reason] = [0, ""];
    const late = setTimeout(() => socket.close(), HANDSHAKE_S * 1000);
    socket.onopen = () => {
      const { metadata, resume } = this;
      this.toldS = seconds();
      socket.send(encodeMessage({ type: "join", ...this.join, metadata, resumable: true, resume }));
      this.resume = "";
    };
    socket.onmessage = ({ data }) => {
      try {
        const message = this.receive(new Uint8Array(data));
        if (message?.type === "joined") clearTimeout(late);
        if (message?.type === "bye") {
          const { url } = message;
          reason = url ? `the room is at another relay, ${url}: open the link there`
            : message.reason;
          code = message.code;
        }
      } catch (error) {
        if (!(error instanceof WireError)) throw error;
        [code, reason] = [4000, `the relay broke the protocol: ${error.message}`];
        socket.close(4000);
      }
    };
    socket.onclose = (event) => {
      clearTimeout(late);
      if (this.socket === socket) this.ended(code || event.code, reason || event.reason);
    };
  }

  /** @param {Uint8Array} bytes */
  receive(bytes) {
    if (bytes[0] === MEDIA_KIND) {
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
    if (message.type !== "bye") {
      this.note(message);
      this.handler.message(message);
    }
    return message;
  }

  /** Remember who sends what. @param {Message} message */
  note({ type, peer, peers, peer_id: id, ...rest }) {
    if (type === "joined") {
      this.publishers.clear();
      peers.forEach((/** @type {Peer} */ each) => this.addPeer(each));
      this.tracks = rest.tracks;
      this.resume = rest.resume;
      if (!rest.resumed) this.sequences.fill(0);
      this.mutedStreams.clear();
      this.isJoined = this.hasJoined = true;
      this.joinedS = seconds();
      this.refusedSinceS = 0;
    } else if (type === "peer_joined") {
      this.addPeer(peer);
    } else if (type === "peer_left") {
      this.clocks.delete(id);
    } else if (type === "stream_muted") {
      this.mutedStreams[rest.is_muted ? "add" : "delete"](rest.stream);
    }
  }

  /** @param {Peer} peer */
  addPeer({ peer_id: id, tracks }) {
    for (const { stream } of tracks) this.publishers.set(stream, id);
  }

  /** About what the clock of a stream's sender shows. @param {number} stream @param {number} now */
  expectedUs(stream, now) {
    const [capturedUs, atS] = this.clocks.get(this.publishers.get(stream) ?? "") ?? [0, 0];
    return capturedUs + Math.round((now - atS) * 1e6);
  }

  /** @param {number} code @param {string} reason */
  ended(code, reason) {
    const now = seconds();
    this.socket = null;
    if (this.isJoined && now - this.joinedS >= SETTLED_S) this.waitS = FIRST_WAIT_S;
    this.isJoined = false;
    let isFinal = !AGAIN.includes(code);
    if (MAY_PASS.includes(code) && this.hasJoined) {
      this.refusedSinceS ||= now;
      isFinal = now - this.refusedSinceS >= RETURN_S;
    }
    if (isFinal) {
      this.handler.left("ended", reason || `the relay closed the connection (${code})`);
      return;
    }
    this.handler.left(this.hasJoined ? "reconnecting" : "joining", reason
      || "no answer from the relay");
    // Chance spreads the return of a full room over time.
    this.timer = setTimeout(() => this.connect(), this.waitS * (500 + 500 * Math.random()));
    this.waitS = Math.min(2 * this.waitS, LONGEST_WAIT_S);
  }

  leave() {
    clearTimeout(this.timer);
    const { socket } = this;
    this.tell({ type: "bye", code: 1000, reason: "", url: "" });
    this.socket = null;
    this.isJoined = false;
    socket?.close(1000);
  }

  /** Say something to the relay; false while that cannot be. @param {Message} message */
  tell(message) {
    if (this.isJoined) this.socket?.send(encodeMessage(message));
    return this.isJoined;
  }

  /** Set an entry of our metadata, which is told at most once a second. @param {string} key
   * @param {string} value */
  describe(key, value) {
    this.metadata = { ...this.metadata, [key]: value };
    if (!value) delete this.metadata[key];
    clearTimeout(this.tellTimer);
    this.tellTimer = setTimeout(() => {
      this.toldS = seconds();
      this.tell({ type: "update_metadata", metadata: this.metadata });
    }, Math.max(this.toldS + TELL_INTERVAL_S - seconds(), 0) * 1000);
  }

  /** Give a frame of a track of ours its number, a multiple of one; null: it is not to be sent.
   * @type {(kind: "face" | "voice", payload: Uint8Array, capturedUs: number, multiple: number) =>
   * Frame | null} */
  number(kind, payload, capturedUs, multiple) {
    const place = this.tracks.findIndex((track) => track.kind === kind);
    const isFull = (this.socket?.bufferedAmount ?? 0) > MAX_WAITING_BYTES[kind];
    if (!this.isJoined || isFull || place < 0) return null;
    const sequence = (Math.ceil(this.sequences[place] / multiple) * multiple) % 65_536;
    this.sequences[place] = (sequence + 1) % 65_536;
    const { stream } = this.tracks[place];
    return this.mutedStreams.has(stream) ? null : { stream, sequence, capturedUs, payload };
  }

  /** @param {Frame} frame */
  send(frame) {
    if (this.isJoined) this.socket?.send(encodeFrame(frame));
  }
}
