/** Gives the relay an avatar's file, so that the others can see who wears it (docs/wire.md). */

import { MAX_FILE_BYTES, openAvatar } from "./avatar.js";
import { idOf } from "./call.js";
import { decodeMessage, encodeMessage, said } from "./wire.js";

const [SUBPROTOCOL, CHUNK_KIND, CHUNK_BYTES] = ["pica.store.1", 3, 16_383];

/** Check a file and give it; its id. Rejects with one clear line.
 * @param {File} file @param {URL} base Of the relay. @param {string} token */
export async function giveAvatar(file, base, token) {
  if (file.size > MAX_FILE_BYTES) throw new Error(`${file.name} is too large for an avatar`);
  const bytes = await file.arrayBuffer();
  try {
    openAvatar(bytes);
  } catch (error) {
    throw new Error(`${file.name}: ${said(error)}`);
  }
  const id = await idOf(bytes);
  const url = new URL(base);
  url.protocol = url.protocol.replace("http", "ws");
  await new Promise((resolve, reject) => {
    const socket = new WebSocket(url, [SUBPROTOCOL]);
    socket.binaryType = "arraybuffer";
    let reason = "it does not answer as a store";
    socket.onopen = () =>
      socket.send(encodeMessage({ type: "offer", sha256: id, size: bytes.byteLength, token }));
    socket.onmessage = ({ data }) => {
      const message = decodeMessage(new Uint8Array(data));
      if (message.type === "stored") resolve(null);
      if (message.type === "bye") reason = message.reason || reason;
      for (let at = 0; message.type === "ready" && at < bytes.byteLength; at += CHUNK_BYTES) {
        socket.send(new Blob([Uint8Array.of(CHUNK_KIND), bytes.slice(at, at + CHUNK_BYTES)]));
      }
    };
    socket.onclose = (event) =>
      reject(new Error(`the relay does not take the avatar: ${event.reason || reason}`));
  });
  return id;
}
