// The status line of saving.

const TEXTS = {
  saved: "Saved", saving: "Saving…", offline: "Not saved – server not reachable, retrying",
  failing: "Not saved – retrying", refused: "Not saved", conflict: "Not saved – changed elsewhere",
  draft: "Press Done to save the template",
};
const WRONG = ["offline", "failing", "refused", "conflict"];

export class SaveStatus {
  /** say(text): announce to screen readers; ondecide(): resolve a conflict. */
  constructor({ app, say, ondecide }) {
    const { h, button } = app.ui;
    Object.assign(this, { app, say });
    this.element = h("span", { class: "save-status", dataset: { testid: "save-status", state: "saved" } }, TEXTS.saved);
    this.button = button("Decide…", { small: true, hidden: true, onclick: ondecide });
    this.complaint = null;
  }

  get state() {
    return this.element.dataset.state;
  }

  show(state, message) {
    const before = this.state;
    this.element.dataset.state = state;
    this.element.textContent =
      state === "offline" && message
        ? "Not saved, but kept in the browser"
        : TEXTS[state];
    this.element.title = message || this.element.textContent;
    this.complain(state === "refused" || state === "failing" ? `Not saved: ${message}` : "");
    this.button.hidden = state !== "conflict";
    // Announce problems and their end, not every save.
    if (WRONG.includes(state) && before !== state) this.say(this.element.title);
    if (WRONG.includes(before) && state === "saved") this.say(TEXTS.saved);
  }

  /** Show an error message until it is resolved. */
  complain(text) {
    if (text === this.complaint?.text) return;
    this.complaint?.close();
    this.complaint = text ? { text, close: this.app.toast(text, "bad") } : null;
  }
}
