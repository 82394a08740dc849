// Keys of one's own for the commands of the Annotate tab: letters that stand for others, kept in the browser.

import { attempt } from "./unsaved.js";
import { button, dialog, h } from "./ui.js";

const KEY = "liaam-studio:keys";

/** Commands that may have other letters, by their own. */
export const COMMANDS = {
  n: "Next picture without accepting", p: "Place the missing point", v: "Visible or invisible", y: "Confirm a point", u: "Absent",
  x: "Move mirrored points together", m: "Flip the points", f: "Show the picture mirrored", b: "Select with a box", s: "Scale bar",
  t: "Measure", c: "Trace a curve", l: "Names", k: "Curves", e: "Ellipses", r: "Loupe", h: "Hide all points",
};

/** The letter of a command by the letter that is pressed for it. @returns {Record<string, string>} */
export const chosenKeys = () => attempt(() => JSON.parse(localStorage.getItem(KEY))) ?? {};

/** The letter of the command that a pressed key means; keys without a command of one's own mean themselves, unless their
 *  command has another letter. @param {Record<string, string>} chosen */
export function meant(key, chosen) {
  const letter = key.toLowerCase();
  if (letter in chosen) return chosen[letter];
  return Object.values(chosen).includes(letter) ? "" : letter;
}

/** Let a key event mean what the person has chosen, in the Annotate tab. */
export function translate(event) {
  if (event.key.length !== 1 || event.ctrlKey || event.metaKey || event.altKey) return;
  const key = meant(event.key, chosenKeys());
  if (key !== event.key.toLowerCase()) Object.defineProperty(event, "key", { value: event.shiftKey ? key.toUpperCase() : key });
}

/** What is wrong with letters by command; "" if nothing is. */
export function faultIn(letters) {
  const used = new Map();
  for (const [command, letter] of Object.entries(letters)) {
    if (!/^[a-z]$/.test(letter)) return `${COMMANDS[command]}: give one letter from A to Z`;
    if (used.has(letter)) return `${COMMANDS[command]} and ${used.get(letter)} have the same key, ${letter.toUpperCase()}`;
    used.set(letter, COMMANDS[command]);
  }
  return "";
}

/** Ask for other letters. @param {(text: string, kind?: string) => any} toast */
export async function chooseKeys(toast) {
  const chosen = chosenKeys();
  const letterOf = (command) => Object.entries(chosen).find(([, own]) => own === command)?.[0] ?? command;
  const fields = Object.keys(COMMANDS).map((command) => h("input.text.hotkey", {
    type: "text", maxlength: "1", size: "2", value: letterOf(command).toUpperCase(), "aria-label": COMMANDS[command], testid: `key-${command}`,
    onfocus: (event) => event.target.select(),
  }));
  const read = () => Object.fromEntries(Object.keys(COMMANDS).map((command, i) => [command, fields[i].value.trim().toLowerCase()]));
  const reset = button("As they were", { small: true, onclick: () => Object.keys(COMMANDS).forEach((command, i) => { fields[i].value = command.toUpperCase(); }) });
  const body = h("div.column", h("p.small.muted", "Letters for the commands of Annotate, in this browser. I, D, Z, A, G and W are those of all tabs."),
    h("div.hotkeys", Object.values(COMMANDS).map((what, i) => h("label.row", fields[i], what))), h("div.row", reset));
  const save = { label: "Save", kind: "primary", value: "save", testid: "keys-save" };
  if ((await dialog("Your own keys", body, [{ label: "Cancel", value: null }, save], { wide: true })) !== "save") return;
  const letters = read();
  const fault = faultIn(letters) || (Object.values(letters).find((letter) => "idzagw".includes(letter)) ? "I, D, Z, A, G and W have a meaning in all tabs: choose other letters" : "");
  if (fault) return void toast(`Keys not changed. ${fault}.`, "bad");
  const others = Object.entries(letters).filter(([command, letter]) => command !== letter).map(([command, letter]) => [letter, command]);
  localStorage.setItem(KEY, JSON.stringify(Object.fromEntries(others)));
  toast("Keys saved.", "good");
}
