/**
 * The people of a call on their way to the picture: who is ready, who sits where, what is decoded and
 * drawn; as `ui/avatar_presenter.py` does it. Knows no page and no loop.
 */

import { Head, LISTENER_S, Scheduler, seeHeads } from "./schedule.js";
import { headRect, nearing, orbitLimits, planCamera, planSeats, SHOULDERS_M, USUAL_SPAN } from "./seats.js";
import { clamp, column, headMatrix } from "./space.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Placement, Renderer, View } from "./draw.js" */
/** @import { Target } from "./gl.js" */
/** @import { FreeShares, Layout, Orbit, SeatPlan } from "./seats.js" */
/** @import { Camera, Matrix } from "./space.js" */
/** @import { Face, Participant } from "./types.js" */
/** @typedef {Participant<Avatar>} Person */
/**
 * @typedef {object} Wanted What the user wants to see.
 * @property {Layout} layout
 * @property {string} pinned The id of the one who fills the picture; empty for none.
 * @property {Orbit} orbit
 * @property {Partial<FreeShares>} free
 * @property {Person | null} self Whom the small picture in the lower left corner shows.
 * @property {number} rise How far above the lower border that is, part of the height.
 */
/** @typedef {{person: Person, rect: number[] | null}} Label A participant, and left, top, right, bottom of where they may be, pixels. */
/** @typedef {{placement: Placement, entry: Entry, person: Person}} Placed */

/** @type {Record<string, number>} */
const FADE_OF_STATUS = { waiting: 0.6, stale: 0.8, away: 0.4 };
const [FADE_S, GLOW_STEPS, SETTLE_S] = [0.5, 4, 0.15];
const SELF_SHARE = 0.2;

/** What is kept of a person from frame to frame. */
class Entry {
  constructor() {
    /** @type {Avatar | null} */
    this.avatar = null;
    /** @type {Head | null} */
    this.head = null;
    /** @type {Face | null} */
    this.face = null;
    this.shouldersM = SHOULDERS_M;
    this.span = USUAL_SPAN;
    this.problem = "";
    this.fade = FADE_OF_STATUS.waiting;
    this.glow = 0;
    this.turn = 0;
    /** @type {Matrix | null} */
    this.seat = null;
  }
}

export class Scene {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    this._renderer = renderer;
    this.scheduler = new Scheduler();
    /** @type {Map<string, Entry>} */
    this._entries = new Map();
    /** @type {{plan: SeatPlan, size: string} | null} */
    this._settled = null;
    this._drawnS = -Infinity;
    /** Whether people take their seats at once. */
    this.isCalm = false;
  }

  /** Why a participant is a placeholder; empty if nothing is wrong. @param {string} id */
  problemOf(id) {
    return this._entries.get(id)?.problem ?? "";
  }

  /**
   * Plan, decode and draw a frame.
   * @param {Person[]} people @param {Wanted} wanted @param {Target} target
   * @param {number} budgetS What decoding and drawing may take. @param {number} now
   * @param {((camera: Camera, target: Target) => View[])} [viewsOf] For a headset, what its eyes see.
   */
  draw(people, wanted, target, budgetS, now, viewsOf) {
    const { width, height } = target;
    const sinceS = now - this._drawnS;
    this._drawnS = now;
    const all = wanted.self && !people.includes(wanted.self) ? [...people, wanted.self] : people;
    this._refresh(all, now);
    const entries = people.map(({ id }) => /** @type {Entry} */ (this._entries.get(id)));
    const plan = this._seat(people, entries, wanted, width / height, sinceS);
    const limits = orbitLimits(plan, entries.map(({ span }) => span));
    const camera = planCamera(plan, wanted.orbit, width, height, limits);
    const placed = people.map((person, index) => this._place(person, entries[index], plan.seats[index], sinceS));
    /** @type {View[]} */
    const views = viewsOf ? viewsOf(camera, target) : [{ camera, rect: [0, 0, width, height], slots: new Set(people.map(({ id }) => id)) }];
    const cameras = views.map((view) => view.camera);
    if (wanted.self && !viewsOf) {
      const own = this._placeSelf(wanted.self, target, wanted.rise, sinceS);
      placed.push(own.placed);
      views.push(own.view);
    }
    const { requests, shadedPx } = this._plan(placed, cameras, views, budgetS, now);
    this._renderer.decode(requests);
    for (const { placement, entry: { head } } of placed) {
      placement.scale = head?.choice?.scale ?? 1;
    }
    const room = { places: plan.seats.map((seat) => column(seat, 3)), speaking: entries.map(({ glow }) => Math.ceil(GLOW_STEPS * glow) / GLOW_STEPS) };
    const drawn = this._renderer.draw(placed.map(({ placement }) => placement), views, room, target);
    const decodesS = requests.reduce((sum, { level, isBoth }) => sum + this.scheduler.costs.decodeS(level, isBoth ? "both" : "expression"), 0);
    /** @type {Label[]} */
    const labels = people.map((person, index) => ({ person, rect: headRect(camera, plan.seats[index]) }));
    return { ...drawn, labels, decodesS, shadedPx, numDecoded: requests.length };
  }

  /** Take the faces of now; avatars are made ready, one a frame. @param {Person[]} people @param {number} now */
  _refresh(people, now) {
    for (const id of this._entries.keys()) {
      if (!people.some((person) => person.id === id)) {
        this._renderer.remove(id);
        this._entries.delete(id);
      }
    }
    let hasAdded = false;
    people.forEach((person, index) => {
      let entry = this._entries.get(person.id);
      if (!entry) {
        entry = new Entry();
        this._entries.set(person.id, entry);
        this._renderer.add(person.id, null);
      }
      if (person.avatar !== entry.avatar && !hasAdded) {
        hasAdded = true;
        this._dress(person, entry);
      }
      const face = person.faceAt(now);
      // While not everybody can be drawn at every face, listeners keep theirs for a turn.
      const turn = Math.floor(now / LISTENER_S + index / people.length);
      const isResting = this.scheduler.isShort && !person.isSpeaking && turn === entry.turn;
      entry.turn = turn;
      entry.face = isResting && entry.face && face ? entry.face : face;
    });
  }

  /** Put a person's avatar on the GPU. @param {Person} person @param {Entry} entry */
  _dress({ id, avatar }, entry) {
    Object.assign(entry, { avatar, head: null, problem: "" });
    try {
      this._renderer.add(id, avatar);
      if (avatar) {
        this.scheduler.costs.observeDecode(256, "both", this._renderer.measureDecode(id));
        entry.head = new Head(id, avatar);
        entry.shouldersM = avatar.bust().widthM;
        entry.span = avatar.manifest.view_span;
      }
    } catch (error) {
      entry.problem = error instanceof Error ? error.message : String(error);
      this._renderer.add(id, null);
    }
  }

  /** Seats on their way to where people should be; at once on a picture of another size. @param {Person[]} people @param {Entry[]} entries @param {Wanted} wanted @param {number} aspect @param {number} sinceS */
  _seat(people, entries, { layout, pinned, free }, aspect, sinceS) {
    const shouldersM = Math.max(...entries.map((entry) => entry.shouldersM), entries.length ? 0 : SHOULDERS_M);
    const goal = planSeats(layout, people.length, aspect, { pinned: people.findIndex(({ id }) => id === pinned), free, shouldersM });
    let plan = goal;
    if (this._settled?.size === String(aspect) && people.length && entries.some(({ seat }) => seat)) {
      const seats = goal.seats.map((seat, index) => entries[index].seat ?? seat);
      plan = nearing({ ...this._settled.plan, seats }, goal, this.isCalm ? 1 : 1 - Math.exp(-sinceS / SETTLE_S));
    }
    this._settled = { plan, size: String(aspect) };
    entries.forEach((entry, index) => (entry.seat = plan.seats[index]));
    return plan;
  }

  /** @param {Person} person @param {Entry} entry @param {Matrix} seat @param {number} sinceS @returns {Placed} */
  _place(person, entry, seat, sinceS) {
    const { face } = entry;
    const step = sinceS / FADE_S;
    const status = person.isAway ? "stale" : face?.status ?? "waiting";
    entry.fade += clamp((FADE_OF_STATUS[status] ?? 0) - entry.fade, -step, step);
    entry.glow += clamp((person.isSpeaking ? 1 : 0) - entry.glow, -step, step);
    const matrix = headMatrix(seat, face?.rotation ?? [0, 0, 0], face?.translation ?? [0, 0, 0]);
    return { person, entry, placement: { slot: person.id, matrix, fade: entry.fade, scale: 1 } };
  }

  /** Oneself in the lower left corner, seen from the front. @param {Person} self @param {Target} target @param {number} rise @param {number} sinceS */
  _placeSelf(self, { width, height }, rise, sinceS) {
    const side = Math.round(Math.min(width, height) * SELF_SHARE);
    const plan = planSeats("grid", 1, 1);
    const camera = planCamera(plan, { yaw: 0, pitch: 0, zoom: 1 }, side, side, [0, 0, 0, 0]);
    const placed = this._place(self, /** @type {Entry} */ (this._entries.get(self.id)), plan.seats[0], sinceS);
    const inset = Math.round(side / 10);
    const bottom = inset + Math.round(rise * height);
    /** @type {View} */
    const view = { camera, rect: [inset, bottom, inset + side, bottom + side], slots: new Set([self.id]) };
    return { placed, view };
  }

  /** What is decoded now; streams are told what is wanted of them. @param {Placed[]} placed @param {Camera[]} cameras @param {View[]} views @param {number} budgetS @param {number} now */
  _plan(placed, cameras, views, budgetS, now) {
    const heads = placed.flatMap(({ placement, entry, person }) => {
      const { head, face } = entry;
      if (!head || !face) {
        return [];
      }
      [head.matrix, head.latent, head.isListening] = [placement.matrix, face.latent, !person.isSpeaking];
      return [{ head, person }];
    });
    const own = views.length > cameras.length ? views[views.length - 1] : null;
    const isOwn = (/** @type {Head} */ { slot }) => own?.slots?.has(slot) ?? false;
    seeHeads(heads.flatMap(({ head }) => (isOwn(head) ? [] : [head])), cameras);
    if (own) {
      seeHeads(heads.flatMap(({ head }) => (isOwn(head) ? [head] : [])), [own.camera]);
    }
    const plan = this.scheduler.plan(heads.map(({ head }) => head), budgetS, now);
    heads.forEach(({ head: { choice }, person }) => person.want(choice?.every ?? 1));
    heads.sort((a, b) => b.head.sight.headPx - a.head.sight.headPx);
    const requests = heads.flatMap(({ head }) => head.request(now) ?? []);
    return { requests, shadedPx: plan.shadedPx };
  }
}
