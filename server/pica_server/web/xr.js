/** The room in a headset, by WebXR: people around a table at true scale, seen from its near side.
 * Tried in an emulator alone. */

import { seconds } from "./clock.js";
import { planTable } from "./seats.js";
import { along } from "./space.js";

/** How high above the floor the eyes of people who sit are. */
const EYES_M = 1.2;
/** Of a frame at 72 images a second. */
const BUDGET_S = 0.6 / 72;

/** What a headset's eye sees, whose floor begins below the viewer. Matrices are GL's.
 * @type {(eye: any, viewer: Vector, width: number, height: number) => Camera} */
function cameraOf({ projectionMatrix: p, transform: { matrix } }, viewer, width, height) {
  /** @type {Vector[]} */
  const [right, up, back, centre] =
    [0, 4, 8, 12].map((at) => [matrix[at], matrix[at + 1], matrix[at + 2]]);
  return {
    centre: along(along(centre, 1, viewer), -EYES_M, [0, 1, 0]),
    axes: [right, up, along([0, 0, 0], -1, back)],
    lens: [(p[8] - 1) / p[0], (p[9] - 1) / p[5], (p[8] + 1) / p[0], (p[9] + 1) / p[5]],
    width, height,
  };
}

/** Show people in a headset until it is taken off. @param {Picture} picture
 * @param {() => Person[]} people */
export async function enterHeadset(picture, people) {
  const { navigator: { xr }, XRWebGLLayer } = /** @type {any} */ (globalThis);
  const { gl } = picture;
  const session =
    await xr.requestSession("immersive-vr", { requiredFeatures: ["local-floor"] });
  const ended = new Promise((resolve) => session.addEventListener("end", resolve));
  picture.isAway = true;
  try {
    await /** @type {any} */ (gl).makeXRCompatible();
    const layer = new XRWebGLLayer(session, gl, { antialias: false, depth: false, alpha: false });
    session.updateRenderState({ baseLayer: layer });
    const space = await session.requestReferenceSpace("local-floor");
    let number = 0;
    /** @param {number} _ @param {any} moment */
    const draw = (_, moment) => {
      session.requestAnimationFrame(draw);
      const pose = moment.getViewerPose(space);
      if (!pose || gl.isContextLost()) return;
      const { framebuffer, framebufferWidth: width, framebufferHeight: height } = layer;
      const present = people();
      const table = planTable(present.length);
      const eyes = pose.views.map((/** @type {any} */ eye) => {
        const { x, y, width: wide, height: high } = layer.getViewport(eye);
        const camera = cameraOf(eye, table.viewer, wide, high);
        return { camera, rect: [x, y, x + wide, y + high] };
      });
      const target = { framebuffer, width, height, number: ++number };
      picture.scene.drawFrom(eyes, present, table.seats, target, BUDGET_S, seconds());
    };
    session.requestAnimationFrame(draw);
    await ended;
  } catch (error) {
    await session.end().catch(() => {});
    throw error;
  } finally {
    picture.isAway = false;
  }
}
