// Puts the headset on, moves it, and tells the test where each eye sees the face.
import { element, run, until } from "./pages.js";

/** Columns and rows, from the middle, of what is skin in the left half and in the right one. */
const faces = () => new Promise((resolve) => requestAnimationFrame(() => {
  const canvas = element("picture");
  const gl = canvas.getContext("webgl2");
  const { width, height } = canvas;
  const pixels = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const eyes = [0, 1].map(() => ({ count: 0, x: 0, y: 0 }));
  for (let at = 0; at < width * height; ++at) {
    if (pixels[4 * at] - pixels[4 * at + 2] < 40) continue;
    const column = at % width;
    const eye = eyes[column < width / 2 ? 0 : 1];
    eye.count += 1;
    eye.x += (column % (width / 2)) - width / 4;
    eye.y += Math.floor(at / width) - height / 2;
  }
  const found = eyes.map(({ count, x, y }) => ({ count, x: x / count, y: y / count }));
  resolve(found.every(({ count }) => count > 100) && { eyes: found, width, height });
}));

run(async () => {
  await until(() => !element("join").hidden);
  element("name").value = "Ada";
  element("begin").click();
  await until(() => !element("headset").hidden);
  await until(() => document.querySelector("#labels button:not(.faceless)"));
  globalThis.frozenAt = 0;
  element("headset").click();
  await until(() => headset.activeSession);
  // Until the headset's first frame the canvas shows the page, whose face lies across its middle.
  const isApart = ({ eyes, width }) => eyes.every(({ x }) => Math.abs(x) < width / 8);
  const found = { before: await until(async () => {
    const seen = await faces();
    return seen && isApart(seen) && seen;
  }) };
  headset.position.set(0.2, 1.3, 0);
  await new Promise((resolve) => setTimeout(resolve, 1000));
  found.moved = await until(faces);
  const half = Math.SQRT1_2 * 0.2;
  headset.quaternion.set(0, Math.sin(half), 0, Math.cos(half));
  await new Promise((resolve) => setTimeout(resolve, 1000));
  found.turned = { ...(await until(faces)), angle: 2 * half };
  found.ipd = headset.ipd;
  found.fovy = headset.fovy;
  await headset.activeSession.end();
  // The page's own picture is closer. Of a still face it would be drawn once, and read after that.
  delete globalThis.frozenAt;
  found.isBack = await until(async () => (await faces()).eyes?.[0].count > 2 * found.before.eyes[0].count);
  return found;
});
