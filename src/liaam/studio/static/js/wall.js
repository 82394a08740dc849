// The wall: the list of pictures as a grid over the whole page, with their points, to accept many and open the worst.

import { several } from "./annotate-words.js";
import { openIn } from "./strip-filters.js";
import { button, h, iconButton, press, slider, svg } from "./ui.js";

const FIRST = 90; // percent of quality from which points are accepted, until a person chooses another

export const acceptable = (/** @type {Picture[]} */ pictures, least) =>
  pictures.filter(({ state, doubtful, quality }) => state === "proposed" && !doubtful && quality >= least)
    .map(({ name }) => name);

const keyOf = (/** @type {Picture} */ { revision, quality, tag, state }) => [revision, quality, tag, state].join();

/** shown() -> pictures; onchange(goesOn): it was opened, or closed, to go on with one of its pictures or not; onworst(): the worst will be opened; turn(): go to the next page -> pictures of this one.
 *  @param {{app: App, shown: () => Picture[], accept: (names: string[]) => any, onchange: (goesOn: boolean) => any, onworst: () => any, turn: () => Picture[]}} options */
export function createWall({ app, shown, accept, onchange, onworst, turn }) {
  const { api, state } = app;
  const outlines = new Map(); // by name: {key, promise of the drawing} of the points that were in view last
  let isOn = false;
  let isOnWay = false; // whether a picture was opened from the wall, to which a person then returns
  const level = slider({
    min: "50", max: "100", value: String(FIRST), "aria-label": "Least quality to accept", testid: "wall-level", oninput: show,
  });
  const take = button("", { icon: "check", kind: "primary", testid: "wall-accept", onclick: acceptSeen });
  const page = button("Accept these", {
    testid: "wall-page", shortcut: "Shift+Enter", onclick: acceptPage,
    title: "Accept the points of the pictures that are in view, but for doubtful ones, and go on to the next",
  });
  const worst = button("Open the worst", {
    testid: "wall-worst", shortcut: "W", onclick: openWorst,
    title: "Open the first that is not done, or that has a possible slip",
  });
  const element = h("div.wall-bar", { hidden: true }, level, take, page, worst);
  const toggler = iconButton("Wall of all pictures", "wall", () => toggle(), {
    small: true, pressed: false, shortcut: "G", testid: "wall",
  });

  const chosen = () => acceptable(shown(), Number(level.value) / 100);

  function show() {
    const count = chosen().length;
    take.lastChild.textContent = `Accept ${count} above ${level.value} %`;
    take.disabled = !count;
    worst.disabled = !openIn(shown()).length;
  }

  /** A training that ends later may change points that a person has looked at, but not accepted ones. */
  function acceptPage() {
    const pictures = turn();
    return acceptSome(() => acceptable(pictures.map(({ name }) => state.picture(name)), 0));
  }

  /** Return from a picture that was opened here, and accept the page; false if none was. */
  function resume() {
    if (!isOnWay) return false;
    open(true);
    acceptPage();
    return true;
  }

  /** Accept the sure ones, but for those that were looked at before a model placed their points anew. */
  function acceptSeen() {
    const isNew = (name) => outlines.has(name) && outlines.get(name).key !== keyOf(state.picture(name));
    const stale = several(chosen().filter(isNew).length, "picture");
    if (chosen().some(isNew))
      app.toast(`A newer model has placed the points of ${stale} that you looked at. Look again, then accept them.`);
    return acceptSome(() => chosen().filter((name) => !isNew(name)));
  }

  async function acceptSome(names) {
    await app.saved();
    const found = names();
    if (found.length) accept(found);
  }

  /** goesOn: whether it closes for one of its pictures. */
  function open(on, goesOn = false) {
    if (isOn === on || !state.project.pictures.length) return;
    isOn = on;
    document.documentElement.dataset.wall = on ? "on" : "off";
    press(toggler, on);
    element.hidden = !on;
    onchange(goesOn);
  }

  const toggle = () => open(!isOn);

  /** Close the wall for one of its pictures. */
  function leave() {
    isOnWay = isOn;
    open(false, true);
  }

  /** Do not return to the wall: what it shows is chosen anew. */
  function forget() { isOnWay = false; }

  function openWorst() {
    forget();
    onworst();
    const [picture] = openIn(shown());
    if (!picture) return;
    open(false, true);
    app.openTab("annotate");
    state.select(picture.name);
  }

  async function outline(picture, face) {
    const { name, placed, state: progress } = picture;
    if (!placed && progress !== "proposed") return;
    const key = keyOf(picture);
    const retried = () => { outlines.delete(name); return null; };
    if (outlines.get(name)?.key !== key) outlines.set(name, { key, drawn: draw(name).catch(retried) });
    const drawn = await outlines.get(name).drawn;
    const before = face.querySelector(".wall-points");
    if (!drawn || before?.dataset.key === key) return;
    before?.remove();
    const own = drawn.cloneNode(true);
    own.dataset.key = key;
    face.append(own);
  }

  async function draw(name) {
    const { points, width, height } = await api.get(api.url("pictures/{name}/landmarks", { name }), { quiet: true });
    const d = points.filter(Boolean).map(([x, y]) => `M${x.toFixed(1)} ${y.toFixed(1)}h0`).join("");
    const dot = Math.max(width, height) / 60;
    const viewBox = `-0.5 -0.5 ${width} ${height}`;
    return svg("svg", { class: "wall-points", viewBox, "stroke-width": dot, "aria-hidden": "true" }, svg("path", { d }));
  }

  return {
    element, toggler, open, toggle, leave, forget, openWorst, acceptPage, resume, outline, show,
    get on() { return isOn; },
    get onWay() { return isOnWay; },
  };
}
