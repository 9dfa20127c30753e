/** The page around the picture: the form to join, names, the bar of buttons, keys and gestures. */

import { LAYOUTS } from "./seats.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Picture } from "./picture.js" */
/** @import { Label, Person, Wanted } from "./scene.js" */
/** @import { CallSurface } from "./types.js" */

const [ORBIT_PER_PX, ZOOM_PER_STEP, KEY_STEP_PX, TAP_PX] = [0.005, 1.1, 24, 6];
const [BAR_PX, LABEL_PX, FADES_BELOW, NARROW_PX] = [72, 40, 0.3, 800];

/** @template {HTMLElement} [T=HTMLElement] @param {string} id @returns {T} */
export const element = (id) => /** @type {any} */ (document.getElementById(id));

/** What a person is said to be, in a few words; empty for nothing. @param {Person} person @param {string} problem */
export function stateOf(person, problem) {
  if (person.isAway) {
    return "connection lost";
  }
  const states = [
    person.note || problem || (person.avatar ? "" : person.avatarId ? "avatar is loading" : "watches"),
    person.seal === "waiting" ? "not verified yet" : person.seal === "secret differs" ? "has another secret" : "",
    person.isFaceMuted ? "face is muted" : "",
    person.isVoiceMuted ? "muted" : "",
    person.isRecording ? "records" : "",
  ];
  return states.filter(Boolean).join(" · ");
}

/** What the user sees and does in a call. */
export class CallView {
  /** @param {CallSurface<Avatar>} call @param {Picture} picture @param {() => void} onLeave */
  constructor(call, picture, onLeave) {
    this._call = call;
    this._picture = picture;
    /** @type {Wanted} */
    this.wanted = { layout: "line", pinned: "", orbit: { yaw: 0, pitch: 0, zoom: 1 }, free: {}, self: call.self, rise: 0 };
    this._showsSelf = true;
    /** @type {Map<string, {button: HTMLButtonElement, text: string}>} */
    this._labels = new Map();
    /** @type {Label[]} */
    this._shown = [];
    /** @type {Map<number, {x: number, y: number}>} */
    this._pointers = new Map();
    this._moved = 0;
    this._stop = new AbortController();
    this._listen(onLeave);
    this.refresh();
  }

  close() {
    this._stop.abort();
    this._labels.forEach(({ button }) => button.remove());
  }

  /** Show how the call stands. */
  refresh() {
    const { status, voice, self } = this._call;
    this.wanted.self = this._showsSelf ? self : null;
    this.wanted.rise = window.innerWidth < NARROW_PX ? BAR_PX / window.innerHeight : 0;
    this.wanted.free = { bottom: Math.min(BAR_PX / Math.max(window.innerHeight, 1), 0.2) };
    const isTurned = this.wanted.pinned !== "" || this.wanted.orbit.zoom !== 1 || this.wanted.orbit.yaw !== 0 || this.wanted.orbit.pitch !== 0;
    element("reset").hidden = !isTurned;
    element("hear").hidden = !voice.needsTap;
    element("mute").textContent = voice.isMuted ? "Unmute" : "Mute";
    element("mute").setAttribute("aria-pressed", String(!voice.isMuted));
    element("self").hidden = !self;
    element("self").setAttribute("aria-pressed", String(this._showsSelf));
    element("layout").textContent = `Layout: ${this.wanted.layout}`;
    const isEmpty = !this._call.participants.length && status.state === "joined";
    const lines = [status.state === "joined" ? "" : status.reason || `${status.state} …`, voice.note, isEmpty ? "Nobody else is here yet." : ""];
    const notice = lines.filter(Boolean).join(" ");
    if (element("notice").textContent !== notice) {
      element("notice").textContent = notice;
    }
  }

  /** Put names below heads. @param {Label[]} labels */
  place(labels) {
    this._shown = labels;
    const gone = new Set(this._labels.keys());
    for (const { person, rect } of labels) {
      gone.delete(person.id);
      const { button } = this._label(person);
      button.hidden = rect === null;
      if (rect) {
        // Where a bust fades.
        const below = rect[3] + FADES_BELOW * (rect[3] - rect[1]);
        const [x, y] = [(rect[0] + rect[2]) / 2, Math.min(below, window.innerHeight - BAR_PX - LABEL_PX)];
        button.style.transform = `translate(${Math.round(x)}px, ${Math.round(y)}px) translateX(-50%)`;
      }
    }
    for (const id of gone) {
      this._labels.get(id)?.button.remove();
      this._labels.delete(id);
    }
  }

  /** @param {Person} person */
  _label(person) {
    let label = this._labels.get(person.id);
    if (!label) {
      const button = document.createElement("button");
      button.type = "button";
      button.addEventListener("click", () => this._pin(person.id));
      element("labels").append(button);
      label = { button, text: "" };
      this._labels.set(person.id, label);
    }
    const state = stateOf(person, this._picture.problemOf(person.id));
    const isPinned = this.wanted.pinned === person.id;
    const text = [person.name, state, person.isSpeaking, isPinned].join("\n");
    if (label.text !== text) {
      label.text = text;
      const small = document.createElement("small");
      small.textContent = state;
      label.button.replaceChildren(person.name, ...(state ? [small] : []));
      label.button.title = state ? `${person.name}: ${state}` : person.name;
      label.button.classList.toggle("speaking", person.isSpeaking);
      label.button.setAttribute("aria-pressed", String(isPinned));
      label.button.setAttribute("aria-label", `${person.name}${person.isSpeaking ? ", speaking" : ""}${state ? `, ${state}` : ""}: ${isPinned ? "show all" : "show large"}`);
    }
    return label;
  }

  /** @param {string} id Shown large; the one who is so no longer. */
  _pin(id) {
    this.wanted.pinned = this.wanted.pinned === id ? "" : id;
    this.refresh();
  }

  _reset() {
    Object.assign(this.wanted, { pinned: "", orbit: { yaw: 0, pitch: 0, zoom: 1 } });
    this.refresh();
  }

  _nextLayout() {
    this.wanted.layout = LAYOUTS[(LAYOUTS.indexOf(this.wanted.layout) + 1) % LAYOUTS.length];
    this.refresh();
  }

  async _toggleVoice() {
    const { voice } = this._call;
    await (voice.isMuted ? voice.speak() : voice.mute(true));
    this.refresh();
  }

  /** @param {number} right @param {number} down Pixels that the scene was dragged. */
  _orbit(right, down) {
    const { orbit } = this.wanted;
    [orbit.yaw, orbit.pitch] = [orbit.yaw - right * ORBIT_PER_PX, orbit.pitch + down * ORBIT_PER_PX].map((angle) => Math.min(Math.max(angle, -1.3), 1.3));
    this.refresh();
  }

  /** @param {number} ratio */
  _zoom(ratio) {
    const { orbit } = this.wanted;
    orbit.zoom = Math.min(Math.max(orbit.zoom * ratio, 0.4), 12);
    this.refresh();
  }

  /** @param {() => void} onLeave */
  _listen(onLeave) {
    const { signal } = this._stop;
    const { canvas } = this._picture;
    /** @param {string} id @param {() => void} act */
    const on = (id, act) => element(id).addEventListener("click", act, { signal });
    on("mute", () => void this._toggleVoice());
    on("layout", () => this._nextLayout());
    on("reset", () => this._reset());
    on("leave", onLeave);
    on("hear", () => void this._call.voice.start().then(() => this.refresh()));
    on("self", () => {
      this._showsSelf = !this._showsSelf;
      this.refresh();
    });
    for (const event of ["people", "status", "voice"]) {
      /** @type {EventTarget} */ (/** @type {unknown} */ (this._call)).addEventListener(event, () => this.refresh(), { signal });
    }
    window.addEventListener("resize", () => this.refresh(), { signal });
    document.addEventListener("keydown", (event) => this._key(event), { signal });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this._zoom(ZOOM_PER_STEP ** -Math.sign(event.deltaY));
    }, { signal, passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this._pointers.set(event.pointerId, event);
      this._moved = this._pointers.size > 1 ? Infinity : 0;
    }, { signal });
    canvas.addEventListener("pointermove", (event) => this._drag(event), { signal });
    for (const end of /** @type {const} */ (["pointerup", "pointercancel"])) {
      canvas.addEventListener(end, (event) => {
        this._pointers.delete(event.pointerId);
        const { offsetX: x, offsetY: y } = event;
        const hit = this._shown.find(({ rect }) => rect && rect[0] <= x && x <= rect[2] && rect[1] <= y && y <= rect[3]);
        if (end === "pointerup" && this._moved < TAP_PX && hit) {
          this._pin(hit.person.id);
        }
      }, { signal });
    }
  }

  /** One pointer turns the view, two move it closer. @param {PointerEvent} event */
  _drag(event) {
    const before = this._pointers.get(event.pointerId);
    if (!before) {
      return;
    }
    const [right, down] = [event.clientX - before.x, event.clientY - before.y];
    const other = [...this._pointers].find(([id]) => id !== event.pointerId)?.[1];
    this._pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this._moved += Math.hypot(right, down);
    if (other) {
      const apart = Math.hypot(before.x - other.x, before.y - other.y);
      this._zoom(Math.hypot(event.clientX - other.x, event.clientY - other.y) / Math.max(apart, 1));
    } else if (this._moved >= TAP_PX) {
      this._orbit(right, down);
    }
  }

  /** @param {KeyboardEvent} event */
  _key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target instanceof HTMLInputElement) {
      return;
    }
    /** @type {Record<string, () => void>} */
    const keys = {
      m: () => void this._toggleVoice(),
      l: () => this._nextLayout(),
      s: () => element("self").click(),
      Escape: () => this._reset(),
      "+": () => this._zoom(ZOOM_PER_STEP),
      "-": () => this._zoom(1 / ZOOM_PER_STEP),
      ArrowLeft: () => this._orbit(KEY_STEP_PX, 0),
      ArrowRight: () => this._orbit(-KEY_STEP_PX, 0),
      ArrowUp: () => this._orbit(0, KEY_STEP_PX),
      ArrowDown: () => this._orbit(0, -KEY_STEP_PX),
    };
    const person = /^[1-9]$/.test(event.key) ? this._shown[Number(event.key) - 1]?.person : null;
    const act = person ? () => this._pin(person.id) : keys[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  }
}
