// Parts of the page as the tests of it want them: whole runs, told in JSON.
import { Head, Scheduler, seeHeads } from "../../server/pica_server/web/schedule.js";
import { openAvatar } from "../../server/pica_server/web/avatar.js";
import { nearing, orbitLimits, planCamera, planSeats } from "../../server/pica_server/web/seats.js";
import { clipFromWorld, headMatrix, viewDirection } from "../../server/pica_server/web/space.js";
import { compose, sirenSource, specDefines } from "../../server/pica_server/web/glsl.js";

/** Seats on their way from one plan to another, and the camera that is turned; all as flat lists. */
export function seat(from, to, share, orbit, width, height, spans) {
  const [start, goal] = [from, to].map(([layout, count, aspect, options]) => planSeats(layout, count, aspect, options));
  const plan = nearing(start, goal, share);
  const limits = orbitLimits(plan, spans);
  const camera = planCamera(plan, orbit, width, height, limits);
  return { seats: plan.seats.flatMap((seat) => [...seat]), camera: plan.camera, target: plan.target, limits, clip: clipFromWorld(camera), centre: camera.centre };
}

export function pose(seat, rotation, translation, centre) {
  const matrix = headMatrix(Float64Array.from(seat), rotation, translation);
  return { matrix, view: viewDirection(matrix, centre) };
}

/** Plan frame after frame; what each head got. */
export function schedule(avatars, camera, frames) {
  const heads = avatars.map(({ levels, triangles, low, high }, index) => new Head(String(index), {
    levels,
    manifest: { bounds_min_m: low, bounds_max_m: high },
    faces: (level) => ({ length: 3 * triangles[levels.indexOf(level)] }),
  }));
  const scheduler = new Scheduler();
  return frames.map(({ now, budget, people, decodes, draw }) => {
    people.forEach(({ matrix, latent, isListening }, index) => {
      heads[index].matrix = Float64Array.from(matrix);
      heads[index].latent = new Float32Array(256).fill(latent);
      heads[index].isListening = isListening;
    });
    seeHeads(heads, [camera]);
    const { costS, isShort, shadedPx } = scheduler.plan(heads, budget, now);
    for (const head of heads) head.request(now);
    for (const [level, parts, seconds] of decodes) scheduler.costs.observeDecode(level, parts, seconds);
    scheduler.costs.observeDraw(...draw);
    const sights = heads.map(({ sight }) => [sight.visiblePx, sight.headPx, sight.numViews]);
    const choices = heads.map(({ choice: { level, decode, scale, every } }) => [level, decode, scale, every]);
    return { costS, isShort, shadedPx, sights, choices, draw: scheduler.costs.draw };
  });
}

/** The pixel decoder of a spec, and its networks. */
export function pixelDecoder(texts, spec, filtered) {
  const siren = sirenSource(spec);
  const defines = { ...(filtered ? { FILTERED: "" } : {}), ...specDefines(spec) };
  return { siren, text: compose({ ...texts, "siren.glsl": siren }, "pixel_decoder.frag", defines) };
}

let kept = new Uint8Array();

/** Keep a file for `reopen`. */
export function keep(data) {
  kept = data;
}

/** Read the kept avatar under another header, and cut; what is wrong with it. */
export function reopen(header, length) {
  const start = 8 + Number(new DataView(kept.buffer, kept.byteOffset).getBigUint64(0, true));
  const text = new TextEncoder().encode(header);
  const data = new Uint8Array(8 + text.length + kept.length - start);
  new DataView(data.buffer).setBigUint64(0, BigInt(text.length), true);
  data.set(text, 8);
  data.set(kept.subarray(start), 8 + text.length);
  openAvatar(data.slice(0, length).buffer, "id");
}
