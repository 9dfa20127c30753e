/**
 * The page: from a link to a call. A link is `https://RELAY/ROOM#token=…&secret=…`; what stands behind
 * `#` never leaves the browser but in the join. `?tile=NAME&background=transparent` or `green` shows
 * one participant alone, for a browser source of OBS.
 */

import { openAvatar } from "./avatar.js";
import { loadShaders, Picture } from "./picture.js";
import { CallView, element } from "./ui.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { CallSurface } from "./types.js" */

const query = new URLSearchParams(location.search);
const fragment = new URLSearchParams(location.hash.slice(1));
const tile = query.get("tile");
const room = decodeURIComponent(location.pathname.split("/").pop() ?? "") || fragment.get("room") || "";
const texts = loadShaders();
const calm = matchMedia("(prefers-reduced-motion: reduce)");
/** @type {Picture | null} */
let picture = null;

/** One clear line, in the form. @param {unknown} problem */
function complain(problem) {
  element("problem").textContent = problem instanceof Error ? problem.message : String(problem);
  element("call").hidden = true;
  element("join").hidden = false;
}

/** Offer the avatars that ship. */
async function offerAvatars() {
  /** @type {Record<string, string>} */
  const ids = await (await fetch(new URL("avatars.json", import.meta.url))).json();
  element("avatar").append(...Object.entries(ids).map(([name, id]) => new Option(name, id)));
}

/** @param {string} name @param {string} [avatarId] */
async function enter(name, avatarId = "") {
  // Only once, for a browser lends out few contexts.
  picture ??= new Picture(element("picture"), await texts, tile !== null);
  const { Call } = await import("./call.js");
  /** @type {CallSurface<Avatar> & EventTarget} */
  const call = new Call({ openAvatar, base: new URL(".", location.href) });
  element("join").hidden = true;
  element("call").hidden = false;
  const view = new CallView(call, picture, () => call.leave());
  call.addEventListener("status", () => {
    if (call.status.state === "ended") {
      view.close();
      complain(call.status.reason || "You left the call.");
    }
  });
  call.join({ room, token: fragment.get("token") ?? "", secret: fragment.get("secret") ?? "", name, avatarId });
  if (tile === null) {
    void call.voice.start().catch(() => view.refresh());
  }
  show(call, view, picture);
}

/** Draw frame after frame until the call ends. @param {CallSurface<Avatar>} call @param {CallView} view @param {Picture} drawn */
function show(call, view, drawn) {
  const frame = () => {
    if (call.status.state === "ended") {
      return;
    }
    requestAnimationFrame(frame);
    const people = call.participants.filter(({ avatarId, name }) => (tile === null ? avatarId !== "" : name === tile));
    drawn.isCalm = calm.matches;
    const wanted = tile === null ? view.wanted : { ...view.wanted, layout: /** @type {const} */ ("grid"), self: null, free: {} };
    const labels = drawn.draw(people, wanted, performance.now() / 1000);
    if (labels && tile === null) {
      view.place(labels);
    }
  };
  requestAnimationFrame(frame);
}

/** The name of last time, where the browser keeps such things. @param {string} [name] The one to keep. */
function remembered(name) {
  try {
    if (name !== undefined) {
      localStorage.setItem("name", name);
    }
    return localStorage.getItem("name") ?? "";
  } catch {
    return "";
  }
}

function begin() {
  element("old").remove();
  element("room").textContent = room ? `Join ${room}` : "Join a call";
  document.title = room ? `${room} · PiCA` : "PiCA";
  document.body.classList.toggle("tile", tile !== null);
  document.body.classList.toggle("green", tile !== null && query.get("background") === "green");
  if (tile !== null) {
    enter(query.get("name") ?? `Camera of ${tile}`.slice(0, 64)).catch(complain);
    return;
  }
  const name = /** @type {HTMLInputElement} */ (element("name"));
  name.value = remembered();
  element("join").hidden = false;
  offerAvatars().catch(() => {}); // one may join without
  element("join").addEventListener("submit", (event) => {
    event.preventDefault();
    remembered(name.value);
    element("problem").textContent = "";
    const { value } = /** @type {HTMLSelectElement} */ (element("avatar"));
    enter(name.value.trim(), value).catch(complain);
  });
}

begin();
