// What the test pages share: post what they find to the test.
export async function post(path, body) {
  await fetch(path, { method: "POST", body });
}

/** Run a page's work; what it throws ends the test. */
export async function run(work) {
  try {
    await post("/done", JSON.stringify((await work()) ?? {}));
  } catch (error) {
    await post("/done", JSON.stringify({ error: `${error?.stack ?? error}` }));
  }
}

export async function load(name) {
  return (await fetch(name)).json();
}

export async function loadFloats(name) {
  return new Float32Array(await (await fetch(name)).arrayBuffer());
}

/** A context, its canvas, and the graphics around it. */
export async function makeGraphics(width, height, onlyHalfs) {
  const { openGraphics } = await import("./gl.js");
  const canvas = document.body.appendChild(document.createElement("canvas"));
  [canvas.width, canvas.height] = [width, height];
  const gl = canvas.getContext("webgl2", { antialias: false, depth: false, premultipliedAlpha: true });
  return openGraphics(gl, await load("shaders.json"), onlyHalfs);
}

/** The pixels of what is drawn into, from the lowest row up. */
export function readFloats(gl, { framebuffer, width, height }) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  const found = new Float32Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, found);
  return found;
}

export function readBytes(gl, { framebuffer, width, height }) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  const found = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, found);
  return found;
}

export const element = (id) => document.getElementById(id);

/** Wait until something is true. */
export async function until(holds) {
  for (let tries = 0; tries < 3000; ++tries) {
    const found = await holds();
    if (found) return found;
    await new Promise((resolve) => setTimeout(resolve, 10));
  }
  throw new Error(`never came true: ${holds}`);
}
