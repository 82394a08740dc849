// The line that says whether all is saved, and what keeps it from being so.

const TEXTS = {
  saved: "Saved",
  saving: "Saving…",
  offline: "Not saved – server unreachable, will retry",
  failing: "Not saved – will retry",
  refused: "Not saved",
  conflict: "Not saved – changed elsewhere",
  draft: "The template is saved with Done",
};
const WRONG = ["offline", "failing", "refused", "conflict"];

export class SaveStatus {
  /** say(text): to screen readers; ondecide(): a conflict is to be decided. */
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
        ? "Not saved, but kept – open the address that 'liaam studio' printed"
        : TEXTS[state];
    this.element.title = message || this.element.textContent;
    this.complain(state === "refused" || state === "failing" ? `Not saved: ${message}` : "");
    this.button.hidden = state !== "conflict";
    // Read out what went wrong and that it is well again, not every save.
    if (WRONG.includes(state) && before !== state) this.say(this.element.title);
    if (WRONG.includes(before) && state === "saved") this.say(TEXTS.saved);
  }

  /** Say why nothing is saved, once; it goes when there is nothing to complain about. */
  complain(text) {
    if (text === this.complaint?.text) return;
    this.complaint?.close();
    this.complaint = text ? { text, close: this.app.toast(text, "bad") } : null;
  }
}
