// The name of the person who works in this browser, for the log of changes.

import { dialog, h } from "./ui.js";

const KEY = "liaam-studio:who";
export const whoAmI = () => localStorage.getItem(KEY) ?? "";

/** The name, asked for if it is needed and was never given; "" if it is not given, null if the dialog was closed. */
export async function myName(needed) { return needed && !whoAmI() ? askName() : whoAmI(); }

export async function askName() {
  const input = h("input.text", { maxlength: "60", value: whoAmI(), "aria-label": "Your name", testid: "who" });
  const why = "The history of each picture says who placed and checked its points. This browser remembers the name; " +
    "it is saved with your changes in the folder.";
  const actions = [{ label: "Save", kind: "primary", value: "save", testid: "who-save" }];
  const answer = dialog("Your name", h("div.column", why, input), actions);
  input.select();
  if ((await answer) === null) return null;
  localStorage.setItem(KEY, input.value.trim());
  return whoAmI();
}
