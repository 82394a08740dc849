// A message in place of a picture that cannot be shown: an icon, a title and a remedy.

import { h, icon } from "./ui.js";

export class Cover {
  element = h("div.annotate-cover", { hidden: true });

  get isShown() { return !this.element.hidden; }

  /** instead: an element to show, if it is no message. */
  show({ icon: name, title, text, instead = null }) {
    this.element.hidden = false;
    this.element.replaceChildren(instead ?? h("div.empty", icon(name, 40), h("h2", title), h("p", text)));
  }

  hide() {
    this.element.hidden = true;
  }
}
