/**
 * Who sits where, and from where all are seen: `render/seats.py` and `render/views.py`, whose
 * docstrings say why. World: metres, +y up; the viewer is on the +z side.
 */

import { along, clamp, column, cross, dot, frame, length, lookAt, minus, project,
  unit } from "./space.js";

/** @type {Layout[]} */
export const LAYOUTS = ["line", "table", "grid"];
export const SHOULDERS_M = 0.36;
/** Degrees of yaw and pitch, from and to, that an avatar may be seen from where its file says
 * none. */
export const USUAL_SPAN = [-60, 60, -30, 36];
export const HOME = { yaw: 0, pitch: 0, zoom: 1 };
const VERTICAL_FOV = (32 * Math.PI) / 180;
const TANGENT = Math.tan(VERTICAL_FOV / 2);
const [HEAD_HALF_WIDTH_M, HEAD_HALF_HEIGHT_M] = [0.115, 0.165];
const [MIN_SHOULDERS_M, MAX_SHOULDERS_M, SHOULDER_GAP_M, SHOULDER_DEPTH_M] =
  [0.22, 0.56, 0.025, 0.07];
const [TABLE_RADIUS_M, TABLE_ARC, TABLE_PITCH] = [0.62, 2.7, (9 * Math.PI) / 180];
const [HALF_WIDTH_M, BUST_M, PINNED_CHEST_M] = [0.15, 0.3, 0.36];
const ROW_M = BUST_M + HEAD_HALF_HEIGHT_M;
const [FRAME_FILL, FRAME_FILL_ACROSS, ROW_FILL, EYES_SHARE] = [0.9, 0.96, 0.7, 0.36];
const [CLOSE_SHARE, LABEL_SHARE, GRID_INSTEAD, GRID_FROM] = [0.72, 0.075, 1.12, 4];
const [STRIP_BESIDE, STRIP_LINE_SHARE, STRIP_PER_LINE] = [1.25, 0.17, 4];
const [STRIP_HEAD_SHARE, MAX_STRIP_SHARE, SETTLED_M] = [0.26, 0.4, 0.002];
const [KEPT_DEGREES, MAX_YAW, MAX_PITCH] = [4, 70, 50];
const [NEAREST_M, MIN_ZOOM, MAX_ZOOM] = [0.3, 0.4, 12];

/**
 * Seats for people, and the camera that shows them with their names: on a picture so many times as
 * wide as high, whose part below (`bottom`) is kept free; `pinned`, unless it is -1, fills it.
 * @type {(layout: Layout, count: number, aspect: number, bottom?: number, pinned?: number,
 * shouldersM?: number) => SeatPlan} */
export function planSeats(layout, count, aspect, bottom = 0, pinned = -1,
  shouldersM = SHOULDERS_M) {
  const [across, top] = [TANGENT * aspect * FRAME_FILL_ACROSS, TANGENT * FRAME_FILL];
  const view =
    { left: -across, right: across, bottom: TANGENT * (2 * LABEL_SHARE + 2 * bottom) - top, top };
  const shoulders = clamp(shouldersM, MIN_SHOULDERS_M, MAX_SHOULDERS_M);
  if (pinned >= 0 && pinned < count && count > 1) {
    return planPinned(count, pinned, aspect, view, shoulders);
  }
  const spacing = shoulders + SHOULDER_GAP_M;
  const people = Math.max(count, 1);
  let chosen = gridOf(people, view, spacing);
  let seen = framing(chosen, view, HALF_WIDTH_M);
  if (layout !== "grid") {
    // Busts in a row need no room below for their names.
    const fill = TANGENT * ROW_FILL;
    const low = view.bottom - 2 * TANGENT * LABEL_SHARE;
    const inner = { ...view, bottom: Math.max(low, -fill), top: Math.min(top, fill) };
    const row = (layout === "line" ? lineOf : tableOf)(people, inner, spacing);
    const framed = framing(row, inner, HALF_WIDTH_M, BUST_M, top - (top - low) * EYES_SHARE);
    const isOneRow = chosen.places.every((place) => place[1] === chosen.places[0][1]);
    if (isOneRow || away(framed) <= GRID_INSTEAD * away(seen)) [chosen, seen] = [row, framed];
  }
  const seats = chosen.places.slice(0, count)
    .map((place) => seatAt(place, chosen.faced ?? seen.camera));
  return { seats, ...seen };
}

/** A plan, moved by a share of the way to another one; that one where no difference is seen.
 * @type {(plan: SeatPlan, goal: SeatPlan, share: number) => SeatPlan} */
export function nearing(plan, goal, share) {
  /** @param {SeatPlan} each */
  const places = (each) => [each.camera, each.target, ...each.seats.map((seat) => column(seat, 3))];
  const [start, end] = [places(plan), places(goal)];
  const isThere = start.every((place, index) => minus(end[index], place)
    .every((way) => Math.abs(way) < SETTLED_M));
  if (isThere) return goal;
  /** @type {(from: Vector, to: Vector) => Vector} */
  const towards = (from, to) => along(from, share, minus(to, from));
  const [camera, target, ...moved] = start.map((place, index) => towards(place, end[index]));
  const seats = moved.map((place, index) => seatAt(place,
      along(place, 1, towards(column(plan.seats[index], 2), column(goal.seats[index], 2)))));
  return { seats, camera, target };
}

/** On an arc about the viewer. @type {Arrange} */
function lineOf(count, view, spacing) {
  const shape = (view.right - view.left) / (view.top - view.bottom);
  const room = (shape * ROW_M - 2 * HALF_WIDTH_M) / Math.max(count - 1, 1);
  const closer = clamp(room / spacing, CLOSE_SHARE, 1);
  // Shoulders are ellipses, seen from above: so far behind, they just pass each other.
  const behind = 2.2 * SHOULDER_DEPTH_M * Math.sqrt(1 - closer ** 2);
  const across = centred(count).map((place) => place * closer * spacing);
  const radius = Math.max(
    ROW_M / (view.top - view.bottom),
    (across[count - 1] + HALF_WIDTH_M) / Math.atan((view.right - view.left) / 2),
  );
  return {
    places: across.map((place, index) => {
      const angle = place / (radius - SHOULDER_DEPTH_M);
      const far = radius + (index % 2 ? behind : 0);
      return [far * Math.sin(angle), 0, radius - far * Math.cos(angle)];
    }),
  };
}

/** Around the far side of a round table. @type {Arrange} */
function tableOf(count, _, spacing) {
  const radius = Math.max(TABLE_RADIUS_M, ((count - 1) * spacing) / TABLE_ARC);
  const angles = centred(count).map((place) => (place * spacing) / radius);
  /** @type {Vector[]} */
  const places = angles.map((angle) => [radius * Math.sin(angle), 0, -radius * Math.cos(angle)]);
  return { places, pitch: TABLE_PITCH, faced: [0, 0, radius] };
}

/** Seats around a table at true scale, and where the head of who looks on is.
 * @param {number} count */
export function planTable(count) {
  const { places, faced: viewer = [0, 0, 0] } =
    tableOf(count, { left: 0, right: 0, bottom: 0, top: 0 }, SHOULDERS_M + SHOULDER_GAP_M);
  return { seats: places.map((place) => seatAt(place, viewer)), viewer };
}

/** As many columns as make heads largest; the last row stands in the middle. @type {Arrange} */
function gridOf(count, view, spacing) {
  /** How far away a grid is wholly in the picture. @param {number} columns */
  const distance = (columns) => {
    const high = (Math.ceil(count / columns) - 1) * ROW_M + 2 * HEAD_HALF_HEIGHT_M;
    const wide = (columns - 1) * spacing + 2 * HALF_WIDTH_M;
    return Math.max(high / (view.top - view.bottom), wide / (view.right - view.left));
  };
  const most = Math.ceil(count / (count >= GRID_FROM ? 2 : 1));
  const choices = Array.from({ length: most }, (_, index) => index + 1);
  const columns = choices.reduce((best, more) => (distance(more) < distance(best) ? more : best));
  const rows = Math.ceil(count / columns);
  return {
    places: Array.from({ length: count }, (_, index) => {
      const row = Math.floor(index / columns);
      const own = centred(Math.min(columns, count - row * columns));
      return [own[index % columns] * spacing, ((rows - 1) / 2 - row) * ROW_M, 0];
    }),
  };
}

/** One in front, the others in a strip at the right or below. @type {(count: number, pinned:
 * number, aspect: number, view: Tangents, shoulders: number) => SeatPlan} */
function planPinned(count, pinned, aspect, view, shoulders) {
  const isWide = aspect >= STRIP_BESIDE;
  const lines = Math.ceil((count - 1) / STRIP_PER_LINE);
  const perLine = Math.ceil((count - 1) / lines);
  const share = Math.min(lines * STRIP_LINE_SHARE, MAX_STRIP_SHARE);
  const floor = view.bottom - 2 * TANGENT * LABEL_SHARE;
  const left = isWide ? view.right - share * (view.right - view.left) : view.left;
  const top = isWide ? view.top : floor + share * (view.top - floor);
  const own = isWide ? { ...view, right: left } : { ...view, bottom: top };
  const seen = framing({ places: [[0, 0, 0]] }, own, shoulders / 2, isWide ? HEAD_HALF_HEIGHT_M
    : PINNED_CHEST_M);
  const [columns, rows] = isWide ? [lines, perLine] : [perLine, lines];
  const [width, height] = [(view.right - left) / columns, (top - floor) / rows];
  const bustPerHead = ROW_M / (2 * HEAD_HALF_HEIGHT_M);
  const headPerWidth = (2 * HEAD_HALF_HEIGHT_M) / (shoulders + SHOULDER_GAP_M);
  const head = Math.min(height / bustPerHead, width * headPerWidth, STRIP_HEAD_SHARE * 2 * TANGENT);
  const seats = Array.from({ length: count - 1 }, (_, number) => {
    const [cell, line] = isWide ? [Math.floor(number / rows), number % rows]
      : [number % columns, Math.floor(number / columns)];
    // The bust stands in the middle of the cell.
    const y = top - (line + 0.5) * height + (head * (bustPerHead - 1)) / 2;
    const at = along(seen.camera, (2 * HEAD_HALF_HEIGHT_M) / head,
      [left + (cell + 0.5) * width, y, -1]);
    return seatAt(at, seen.camera);
  });
  seats.splice(pinned, 0, seatAt([0, 0, 0], seen.camera));
  return { seats, ...seen };
}

/** The nearest camera that has all heads within a frame, and what it looks at; with the eyes as near
 * to a height of the picture as may be, else all in its middle.
 * @type {(arrangement: Arrangement, view: Tangents, halfWidth: number, below?: number, eyes?:
 * number) => Seen} */
function framing({ places, pitch = 0 }, view, halfWidth, below = HEAD_HALF_HEIGHT_M, eyes) {
  const [sine, cosine] = [Math.sin(pitch), Math.cos(pitch)];
  const turned = places.map(([x, y, z]) => [x, cosine * y - sine * z, sine * y + cosine * z]);
  const bounds = [
    [halfWidth, halfWidth, view.left, view.right],
    [below, HEAD_HALF_HEIGHT_M, view.bottom, view.top],
  ].map(([before, after, low, high], axis) => ({
    most: Math.max(...turned.map((at) => at[axis] + after + high * at[2])),
    least: Math.min(...turned.map((at) => at[axis] - before + low * at[2])),
    low, high,
  }));
  const distance = Math.max(
    ...bounds.map(({ most, least, low, high }) => (most - least) / (high - low)),
    Math.max(...turned.map((at) => at[2])) + HEAD_HALF_WIDTH_M * 2,
  );
  const [[left, right], [low, high]] =
    bounds.map((each) => [each.most - each.high * distance, each.least - each.low * distance]);
  /** @param {number} axis */
  const mean = (axis) => turned.reduce((sum, at) => sum + at[axis], 0) / turned.length;
  const up = eyes === undefined ? (low + high) / 2 : clamp(mean(1) - eyes * distance, low, high);
  /** @type {(depth: number) => Vector} */
  const back = (depth) =>
    [(left + right) / 2, cosine * up + sine * depth, -sine * up + cosine * depth];
  return { camera: back(distance), target: back(mean(2)) };
}

/** A seat whose +z points at another place. @type {(place: Vector, towards: Vector) => Matrix} */
function seatAt(place, towards) {
  const forward = unit(minus(towards, place));
  const right = unit(cross([0, 1, 0], forward));
  return frame(right, cross(forward, right), forward, place);
}

/** -1, 0, 1 and so on. @param {number} count */
const centred = (count) => Array.from({ length: count }, (_, index) => index - (count - 1) / 2);
/** @param {Seen} seen */
const away = ({ camera, target }) => length(minus(camera, target));
const DEGREE = Math.PI / 180;

/** How far the view may turn before a participant is seen from where their avatar was not trained:
 * least and most yaw, least and most pitch, radians.
 * @param {SeatPlan} plan @param {number[][]} spans The same of each seat, in degrees. */
export function orbitLimits(plan, spans) {
  const limits = [-MAX_YAW, MAX_YAW, -MAX_PITCH, MAX_PITCH];
  plan.seats.forEach((seat, index) => {
    const towards = minus(plan.camera, column(seat, 3));
    const [x, y, z] = [0, 1, 2].map((axis) => dot(column(seat, axis), towards));
    const home = [Math.atan2(x, z) / DEGREE, Math.atan2(y, Math.hypot(x, z)) / DEGREE];
    spans[index].forEach((angle, side) => {
      const room = angle - home[side >> 1];
      limits[side] = side % 2
        ? Math.min(limits[side], Math.max(room - KEPT_DEGREES, 0))
        : Math.max(limits[side], Math.min(room + KEPT_DEGREES, 0));
    });
  });
  return limits.map((angle) => angle * DEGREE);
}

/** The plan's camera, turned and moved closer as the user wants. @type {(plan: SeatPlan, orbit:
 * Orbit, width: number, height: number, limits: number[]) => Camera} */
export function planCamera(plan, orbit, width, height, limits) {
  const offset = minus(plan.camera, plan.target);
  const home = length(offset);
  const around = Math.atan2(offset[0], offset[2]) + clamp(orbit.yaw, limits[0], limits[1]);
  const up = Math.asin(offset[1] / home) + clamp(orbit.pitch, limits[2], limits[3]);
  /** @type {Vector} */
  const direction =
    [Math.sin(around) * Math.cos(up), Math.sin(up), Math.cos(around) * Math.cos(up)];
  // Not nearer to a head, and the nearer it comes, the less a notch of the wheel moves the camera.
  const nearest = Math.min(home, plan.seats.reduce((most, seat) => {
    const towards = minus(column(seat, 3), plan.target);
    const way = dot(towards, direction);
    const inside = NEAREST_M ** 2 - dot(towards, towards) + way ** 2;
    return inside > 0 ? Math.max(most, way + Math.sqrt(inside)) : most;
  }, NEAREST_M));
  const zoom = clamp(orbit.zoom, MIN_ZOOM, MAX_ZOOM);
  const distance = zoom > 1 ? nearest + (home - nearest) / zoom : home / zoom;
  return lookAt(along(plan.target, distance, direction), plan.target, VERTICAL_FOV, width, height);
}

/** The part of the picture that a head may cover: left, top, right, bottom in pixels; null if it is
 * not before the camera. @type {(camera: Camera, head: Matrix) => number[] | null} */
export function headRect(camera, head) {
  const [right, up] = camera.axes;
  const reach = along(along([0, 0, 0], HEAD_HALF_WIDTH_M, right), -HEAD_HALF_HEIGHT_M, up);
  const [low, high] = [-1, 1].map((side) => project(camera, along(column(head, 3), side, reach)));
  return low[2] <= 0.02 ? null : [low[0], low[1], high[0], high[1]];
}
