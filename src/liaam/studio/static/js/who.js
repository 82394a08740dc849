// The name of the person who works in this browser, for the log of changes.

import { dialog, h } from "./ui.js";

const KEY = "liaam-studio:who";

export const whoAmI = () => localStorage.getItem(KEY) ?? "";

/** The name, asked for if it is needed and was never given; "" if it is not given, null if the dialog was closed. */
export async function myName(needed) {
  return needed && localStorage.getItem(KEY) === null ? askName() : whoAmI();
}

export async function askName() {
  const input = h("input.text", {
    maxlength: "60", value: whoAmI(), "aria-label": "Your name", testid: "who",
    onkeydown: ({ key }) => key === "Enter" && input.closest("dialog").querySelector(".primary").click(),
  });
  const why = "The history of each picture says who placed and checked its points. The name stays in this browser.";
  const actions = [{ label: "Save", kind: "primary", value: "save", testid: "who-save" }];
  if ((await dialog("Your name", h("div.column", why, input), actions)) === null) return null;
  localStorage.setItem(KEY, input.value.trim());
  return whoAmI();
}
