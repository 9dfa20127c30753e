// Parts of the page as the tests of it want them: whole runs, told in JSON.
import { Head, Scheduler, seeHeads } from "../../server/pica_server/web/schedule.js";
import { openAvatar } from "../../server/pica_server/web/avatar.js";
import { nearing, orbitLimits, planCamera, planSeats } from "../../server/pica_server/web/seats.js";
import { clipFromWorld, headMatrix, viewDirection } from "../../server/pica_server/web/space.js";

/** Seats on their way from one plan to another, and the camera that is turned; all as flat lists. */
export function seat(from, to, share, orbit, width, height, spans) {
  const [start, goal] = [from, to].map((asked) => planSeats(...asked));
  const plan = nearing(start, goal, share);
  const limits = orbitLimits(plan, spans);
  const camera = planCamera(plan, orbit, width, height, limits);
  return { seats: plan.seats.flatMap((seat) => [...seat]), camera: plan.camera, target: plan.target, limits, clip: clipFromWorld(camera), centre: camera.centre };
}

export function pose(seat, rotation, translation, centre) {
  const matrix = headMatrix(Float64Array.from(seat), [...rotation, ...translation]);
  return { matrix, view: viewDirection(matrix, centre) };
}

/** Plan frame after frame, by given costs; what each head got. */
export function schedule(avatars, camera, frames) {
  const heads = avatars.map(({ triangles, low, high }) =>
    new Head({ bounds_min_m: low, bounds_max_m: high }, triangles));
  const costs = { decodeS: (level, decode) => costs.decodes[decode][level] };
  const scheduler = new Scheduler(costs);
  return frames.map(({ now, budget, people, draw, decodes }) => {
    Object.assign(costs, { draw, decodes });
    people.forEach(({ matrix, latent, isListening }, index) => {
      heads[index].matrix = Float64Array.from(matrix);
      heads[index].latent = new Float32Array(256).fill(latent);
      heads[index].isListening = isListening;
    });
    seeHeads(heads, camera);
    const { costS, shadedPx } = scheduler.plan(heads, budget, now);
    for (const head of heads) head.request(now);
    const sights = heads.map(({ sight }) => [sight.visiblePx, sight.headPx]);
    const choices = heads.map(({ choice: { level, decode, scale, every } }) => [level, decode, scale, every]);
    return { costS, isShort: scheduler.isShort, shadedPx, sights, choices };
  });
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
  openAvatar(data.slice(0, length).buffer);
}

export function open(data) {
  return openAvatar(data.buffer);
}
