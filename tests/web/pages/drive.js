// Does in the page what a person does there, and tells the test what is seen.
import { element, load, run, until } from "./pages.js";

const picture = () => new Promise((resolve) => requestAnimationFrame(() => {
  const canvas = element("picture");
  const gl = canvas.getContext("webgl2");
  const [red, green, blue, alpha] = Array.from({ length: 4 }, () => new Set());
  const pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  for (let at = 0; at < pixels.length; at += 4) [red, green, blue, alpha].forEach((found, k) => found.add(pixels[at + k]));
  resolve({ colours: red.size, alphas: [...alpha] });
}));
// Whether the middle of a label's disc is what is seen there.
const showsDisc = (label) => {
  const { left, top, width, height } = label.firstElementChild.getBoundingClientRect();
  return width > 0 && label.contains(document.elementFromPoint(left + width / 2, top + height / 2));
};
const labels = () => [...document.querySelectorAll("#labels button")].map((each) => ({
  text: [...each.children].slice(1).map((part) => part.textContent).join(""), isSpeaking: each.classList.contains("speaking"),
  isFaceless: showsDisc(each), isPinned: each.getAttribute("aria-pressed") === "true",
}));

const drawn = () => until(async () => (await picture()).colours > 60);
const pressed = (key) => document.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));

run(async () => {
  const { isTile } = await load("case.json");
  if (isTile) {
    const found = await until(async () => {
      const { colours, alphas } = await picture();
      return colours > 60 && alphas;
    });
    return { alphas: found, isBarShown: getComputedStyle(element("bar")).display !== "none" };
  }
  await until(() => !element("join").hidden);
  element("name").value = "Ada";
  element("begin").click();
  await until(() => labels().length === 3 && labels().some(({ text }) => text.startsWith("Nora")));
  await drawn();
  const found = { first: await until(() => labels().every(({ text }) => !text.includes("loading")) && !labels()[0].isFaceless && labels()) };
  document.querySelector("#labels button").click();
  found.pinned = await until(() => labels()[0].isPinned && labels());
  pressed("Escape");
  pressed("l");
  found.layout = await until(() => !labels()[0].isPinned && element("layout").textContent);
  element("mute").click();
  found.mute = await until(() => element("mute").textContent === "Mute");
  const loss = element("picture").getContext("webgl2").getExtension("WEBGL_lose_context");
  loss.loseContext();
  await new Promise((resolve) => setTimeout(resolve, 50));
  loss.restoreContext();
  await drawn();
  found.isHealed = !element("picture").getContext("webgl2").isContextLost();
  found.unlabelled = [...document.querySelectorAll("button:not([hidden]), input")].filter((each) => !(each.textContent || each.ariaLabel || each.labels?.length)).length;
  element("leave").click();
  found.problem = await until(() => !element("join").hidden && element("problem").textContent);
  return found;
});
