// The name of the person who works in this browser, for the log of changes.

const KEY = "liaam-studio:who";

export const whoAmI = () => localStorage.getItem(KEY) ?? "";

/** The name, asked for if it is needed and was never given; "" if it is not given, null if the dialog was closed. */
export async function myName(ui, needed) {
  return needed && localStorage.getItem(KEY) === null ? askName(ui) : whoAmI();
}

export async function askName(ui) {
  const input = ui.h("input", { class: "text", maxlength: "60", value: whoAmI(), "aria-label": "Your name" });
  const why = "The history of each picture says who placed and checked its points. The name stays in this browser.";
  input.dataset.testid = "who";
  input.addEventListener("keydown", ({ key, target }) => {
    if (key === "Enter") target.closest("dialog").querySelector(".primary").click();
  });
  const actions = [{ label: "Save", kind: "primary", value: "save", testid: "who-save" }];
  if ((await ui.dialog("Your name", ui.h("div", { class: "column" }, why, input), actions)) === null) return null;
  localStorage.setItem(KEY, input.value.trim());
  return whoAmI();
}
