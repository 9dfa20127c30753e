/** The canvas of a call: its size, its context that may be lost, and frame after frame. */

import { Renderer } from "./draw.js";
import { DrawError, Graphics } from "./gl.js";
import { Scene } from "./scene.js";

/** @import { Texts } from "./glsl.js" */
/** @import { Label, Person, Wanted } from "./scene.js" */

const [MAX_PX, BUDGET_SHARE] = [3840 * 2160, 0.6];
const [SOFTWARE_FPS, DISPLAY_FPS] = [30, 60];

/** The texts of all shaders, which lie beside the modules. @returns {Promise<Texts>} */
export async function loadShaders() {
  return (await fetch(new URL("shaders.json", import.meta.url))).json();
}

export class Picture {
  /**
   * @param {HTMLCanvasElement} canvas @param {Texts} texts @param {boolean} isTile Without a room.
   * @throws {DrawError} This browser cannot draw.
   */
  constructor(canvas, texts, isTile) {
    this.canvas = canvas;
    this._texts = texts;
    this._isTile = isTile;
    this._gl = canvas.getContext("webgl2", { antialias: false, depth: false, powerPreference: "high-performance" });
    if (!this._gl) {
      throw new DrawError("This browser draws no 3D (WebGL 2): try a current Firefox, Chrome or Safari.");
    }
    this.isCalm = false;
    this._fps = DISPLAY_FPS;
    this.numDrawn = 0;
    this._scene = this._makeScene();
    this._fence = /** @type {WebGLSync | null} */ (null);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this._fence = null;
    });
    canvas.addEventListener("webglcontextrestored", () => (this._scene = this._makeScene()));
  }

  /** @param {string} id */
  problemOf(id) {
    return this._scene?.problemOf(id) ?? "";
  }

  /**
   * Draw a frame unless the one before is still being drawn, or the context is lost.
   * @param {Person[]} people @param {Wanted} wanted @param {number} now Seconds.
   * @returns {Label[] | null} Where everybody is, in pixels of the page.
   */
  draw(people, wanted, now) {
    if (!this._scene || this._fence || this._gl?.isContextLost()) {
      return null;
    }
    const ratio = this._resize();
    const { width, height } = this.canvas;
    const started = performance.now();
    this._scene.isCalm = this.isCalm;
    const found = this._scene.draw(people, wanted, { framebuffer: null, width, height }, BUDGET_SHARE / this._fps, now);
    if (found.isNew) {
      ++this.numDrawn;
      this._time(started, found);
    }
    return found.labels.map(({ person, rect }) => ({ person, rect: rect && rect.map((value) => value / ratio) }));
  }

  /** Learn what the frame took, when the GPU is done with it. @param {number} started @param {{triangles: number, shadedPx: number, decodesS: number}} found */
  _time(started, { triangles, shadedPx, decodesS }) {
    const gl = /** @type {WebGL2RenderingContext} */ (this._gl);
    const fence = (this._fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
    gl.flush();
    const look = () => {
      if (this._fence !== fence || !fence) {
        return;
      }
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) {
        setTimeout(look, 1);
        return;
      }
      gl.deleteSync(fence);
      this._fence = null;
      const seconds = (performance.now() - started) / 1000;
      this._scene?.scheduler.costs.observeDraw(triangles, shadedPx, seconds - decodesS);
    };
    setTimeout(look, 1);
  }

  /** Make the canvas as large as it is shown; pixels of it for one of the page. */
  _resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const wanted = window.devicePixelRatio || 1;
    const ratio = Math.min(wanted, Math.sqrt(MAX_PX / Math.max(clientWidth * clientHeight, 1)));
    const [width, height] = [clientWidth, clientHeight].map((side) => Math.max(Math.round(side * ratio), 1));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      [this.canvas.width, this.canvas.height] = [width, height];
    }
    return ratio;
  }

  /** All that is on the GPU, made again after a context was lost. */
  _makeScene() {
    const gl = /** @type {WebGL2RenderingContext} */ (this._gl);
    if (gl.isContextLost()) {
      return null;
    }
    const graphics = new Graphics(gl, this._texts);
    this._fps = graphics.isSoftware ? SOFTWARE_FPS : DISPLAY_FPS;
    return new Scene(new Renderer(graphics, { hasRoom: !this._isTile }));
  }
}
