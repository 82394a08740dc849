// Which side of its object a picture shows, such as a left or a right wing, as a person says.

import { several } from "./annotate-words.js";
import { h, optionsOf } from "./ui.js";

const SIDES = { left: "left", right: "right" };
const NOT_SAID = "by name or shape";

/** What training has done about the sides of the objects. @param {Sides} sides */
export function sidesInWords({ own, other, n_own: n, n_other: nOther }) {
  const isNamed = own !== "original"; // otherwise the sides were not stated
  if (!nOther) return `All training pictures are ${isNamed ? own : "of one side"}.`;
  const count = `${nOther} of ${several(n + nOther, "training picture")} ${nOther === 1 ? "was" : "were"} ${other}`;
  return `${count}, and reflected${isNamed ? ` to be ${own}` : ""}.`;
}

/** Say the side of pictures, "" to withdraw it. The message offers to undo that. @param {App} app */
export async function saySide({ api, state, toast }, names, side) {
  const put = async (/** @type {Record<string, string>} */ sides) => {
    const answer = await state.send((folder) => api.put(api.url("sides"), { sides, folder }));
    await state.refresh();
    return answer;
  };
  const { before } = await put(Object.fromEntries(names.map((name) => [name, side])));
  toast(`Side of ${several(names.length, "picture")}: ${SIDES[side] ?? NOT_SAID}.`, "good", { label: "Undo", onclick: () => put(before) });
}

/** The list that shows and changes the side of the open picture, if objects have sides. @param {import("./annotate.js").Tab} tab */
export function createSideList({ app, state }) {
  const onchange = () => saySide(app, [state.current], list.value).catch((error) => {
    show(); // what is still said
    app.toast(error, "bad");
  });
  let found = { side: "", both: false }; // of the open picture, by its name or shape
  let asked = "";
  const unsaid = h("option", { value: "" });
  const list = h("select.text.side-list", {
    "aria-label": "Side of the object", testid: "picture-side", onchange,
    title: "Which side of the object this picture shows. Pictures of one side are trained and measured reflected",
  }, unsaid, optionsOf(SIDES));
  const element = h("div.row.begin-with", h("span.small.muted.grow", "Side"), list);
  const show = () => {
    const { model, pictures } = state.project;
    const picture = state.picture();
    element.hidden = !model?.sides && !found.both && !pictures.some(({ side }) => side);
    unsaid.textContent = picture?.side || !found.side ? NOT_SAID : `${NOT_SAID}: ${found.side}`;
    list.value = picture?.side ?? "";
    list.disabled = state.readOnly || !picture;
  };

  /** Ask which side the open picture shows whenever it, its points or what is said of it change. */
  async function follow() {
    show();
    const { name, revision, side, placed } = state.picture() ?? {};
    const wanted = JSON.stringify([state.project.folder, name, revision, side, placed]);
    if (!name || wanted === asked) return;
    asked = wanted;
    const answer = await app.api.get(app.api.url("pictures/{name}/side", { name }), { quiet: true }).catch(() => null);
    if (wanted !== asked) return;
    found = answer ?? { side: "", both: found.both };
    show();
  }

  for (const event of ["project", "select"]) state.addEventListener(event, follow);
  follow();
  return element;
}
