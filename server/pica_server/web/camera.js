/** One's own face by a camera. A worker sees it, with MediaPipe's networks, which the relay gives;
 * no picture leaves the page. */

import { getFile } from "./call.js";
import { seconds } from "./clock.js";
import { said } from "./wire.js";

const FRAME_MS = 33;
/** @typedef {{face: Float32Array | null, wish: string}} Seen What the person is to do. */
/** @type {Record<string, string>} */
const REASONS = {
  NotAllowedError: "the browser was not allowed to use the camera",
  NotFoundError: "there is no camera",
  NotReadableError: "the camera cannot be read; another program may use it",
};

export class Camera {
  /** What is wrong, or is to be done, in one line. */
  note = "the camera is being opened";
  isOpen = true;
  /** @type {MediaStream | null} */
  stream = null;
  /** @type {Worker | null} */
  worker = null;

  /** @param {(face: Float32Array | null, capturedS: number) => void} see
   * @param {() => void} changed Called when `note` or `isOpen` change. */
  constructor(see, changed) {
    this.see = see;
    this.changed = changed;
  }

  /** Watch until it is closed. @param {URL} base Of the relay. */
  async open(base) {
    this.changed();
    try {
      const numbers = await (await fetch(new URL("face_networks.json", import.meta.url))).json();
      const task = await getFile(base, numbers.sha256).catch(() => {
        throw new Error("this relay has no face networks (pica webcam setup)");
      });
      if (!navigator.mediaDevices) throw new Error("the browser gives cameras to https alone");
      const stream = await navigator.mediaDevices.getUserMedia(
        { video: { width: 640, height: 480, frameRate: 30, facingMode: "user" } });
      this.stream = stream;
      const worker = new Worker(new URL("finder.js", import.meta.url), { type: "module" });
      this.worker = worker;
      const video = Object.assign(document.createElement("video"),
        { srcObject: stream, muted: true, playsInline: true });
      const [track] = stream.getTracks();
      track.onended = () => this.close("the camera is gone");
      await video.play();
      /** @type {(message: object, moved?: Transferable[]) => Promise<Seen>} */
      const ask = (message, moved = []) => new Promise((resolve, reject) => {
        worker.onmessage = ({ data }) => resolve(data);
        worker.onerror = ({ message: why }) => reject(new Error(why));
        worker.postMessage(message, moved);
      });
      await ask({ task: new Uint8Array(task), numbers });
      while (this.isOpen) {
        const capturedS = seconds();
        const picture = await createImageBitmap(video);
        const seen = await ask({ picture, atS: capturedS }, [picture]);
        if (!this.isOpen) return;
        // A phone in the background repeats its last picture.
        const face = track.muted ? null : seen.face;
        this.see(face, capturedS);
        this.say(face ? seen.wish : "no face in front of the camera");
        await ask({ waitMs: FRAME_MS - 1000 * (seconds() - capturedS) });
      }
    } catch (error) {
      const known = error instanceof DOMException && REASONS[error.name];
      this.close(known || `no camera: ${said(error)}`);
    }
  }

  /** @param {string} note */
  say(note) {
    if (note === this.note) return;
    this.note = note;
    this.changed();
  }

  /** Give the camera back. @param {string} [reason] */
  close(reason) {
    this.isOpen = false;
    this.see(null, seconds());
    this.worker?.terminate();
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.say(reason ? `${reason}: your voice moves your mouth` : "");
    this.changed();
  }
}
