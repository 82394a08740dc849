// A message in place of a picture that cannot be shown: an icon, a title and a remedy.

import { h, icon } from "./ui.js";

export class Cover {
  element = h("div.annotate-cover", { hidden: true });

  get isShown() { return !this.element.hidden; }

  /** more: an element below the text, or null. */
  show({ icon: name, title, text, more = null, action = null }) {
    this.element.hidden = false;
    this.element.replaceChildren(h("div.empty", icon(name, 40), h("h2", title), h("p", text), action, more));
  }

  hide() {
    this.element.hidden = true;
  }
}
