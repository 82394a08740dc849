// Commands of the Annotate tab's buttons and keys.

import { nextToTeach, several, unfinished } from "./assist.js";
import { called, missingText, UNTOUCHED } from "./annotate-words.js";
import { placed } from "./points.js";

const EDGE = 20; // css pixels; a point closer to the border of the view is scrolled into it

export class Commands {
  constructor(tab) {
    Object.assign(this, { tab, marking: tab.marking });
    this.warned = null; // picture with a warning about missing points
    this.escaped = false; // whether Tab leaves the picture
  }

  /** Whether a picture's points can be edited now. */
  get marks() {
    return !this.tab.editing && this.marking.book !== null;
  }

  say(text) {
    this.tab.speaker.say(text);
  }

  // Display ---------------------------------------------------------------------------------------------------------

  flick(what) {
    const { show, toolbar, viewer } = this.tab;
    show[what] = !show[what];
    toolbar.press(what, show[what]);
    viewer.redraw();
  }

  hideMarks(on) {
    if (this.marking.hidden === on) return;
    this.marking.hidden = on;
    this.tab.viewer.redraw();
  }

  toggleBox() {
    const { tab } = this;
    tab.boxing = !tab.boxing;
    tab.toolbar.press("box", tab.boxing);
  }

  toggleMirrored() {
    const { tab, marking } = this;
    if (!tab.template?.mirror) {
      tab.app.toast(
        "The template has no mirrored points. Edit it with Mirror on, or load one with left and right in its names.",
      );
      return;
    }
    marking.mirrored = !marking.mirrored;
    tab.toolbar.press("mirror", marking.mirrored);
    this.say(marking.mirrored ? "Mirrored points move together" : "Points move separately");
  }

  // Selecting -------------------------------------------------------------------------------------------------------

  chooseFromList(index, adds) {
    const { marking } = this;
    const { chosen } = marking;
    if (!adds) marking.select([index]);
    else marking.select(marking.selection.has(index) ? chosen.filter((i) => i !== index) : [...chosen, index]);
    this.reveal(index);
    this.tab.sayPlace(index);
  }

  chooseAll() {
    const { doc } = this.tab;
    doc.select(placed(doc.points), -1);
    this.say(`${several(doc.selection.size, "point")} selected`);
  }

  escape() {
    this.tab.tool.cancel();
    this.marking.select([]);
    this.escaped = true;
  }

  /** Select the next or previous point; false if there is none, so that the focus leaves the picture. */
  stepPoint(by) {
    const index = this.marking.step(by);
    if (index < 0) return false;
    this.reveal(index);
    this.tab.sayPlace(index);
    return true;
  }

  /** Scroll a point into view. */
  reveal(index) {
    const { viewer } = this.tab;
    const point = this.marking.points[index];
    if (!point) return;
    const [x, y] = viewer.toScreen(point);
    const { clientWidth: w, clientHeight: h } = viewer.canvas;
    if (x < EDGE || y < EDGE || x > w - EDGE || y > h - EDGE) viewer.panBy(w / 2 - x, h / 2 - y);
  }

  // Editing ---------------------------------------------------------------------------------------------------------

  undo() {
    this.travel("undo");
  }

  redo() {
    this.travel("redo");
  }

  travel(way) {
    const { tab, marking } = this;
    tab.tool.cancel();
    if (tab.editing) {
      tab.doc.travel(way);
      return;
    }
    const what = marking.travel(way);
    if (what !== null) this.say(`${way === "undo" ? "Undone" : "Redone"}: ${what}`);
  }

  flip() {
    if (!this.marks) return;
    this.marking.flip();
    this.say("Flipped left and right");
  }

  toggleInvisible() {
    const { marking } = this;
    const chosen = marking.chosenPlaced;
    if (!this.marks || !chosen.length) return;
    const hidden = marking.toggleInvisible();
    this.say(`${called(marking.names, chosen)} ${hidden ? "invisible" : "visible"}`);
  }

  removeChosen() {
    const { marking } = this;
    const chosen = marking.chosenPlaced;
    if (!this.marks || !chosen.length) return;
    marking.removeChosen();
    this.say(`${called(marking.names, chosen)} cleared`);
  }

  placeChosen() {
    const index = this.marking.placeChosen(this.tab.viewer);
    if (index >= 0) this.tab.sayPlace(index);
  }

  // Next picture ----------------------------------------------------------------------------------------------------

  accept() {
    const { tab, marking } = this;
    if (!this.marks) return;
    if (marking.state.source === "layout") {
      this.leaveUnchecked();
      return;
    }
    marking.accept();
    const left = marking.missing;
    if (left.length && this.warned !== tab.name) {
      this.warned = tab.name; // warn once, since points may be left out on purpose
      marking.select([left[0]]);
      tab.app.toast(missingText(marking.names, left));
      return;
    }
    this.goNext();
  }

  /** Leave the mean shape as it is: warn once, then mark the picture as not checked. */
  async leaveUnchecked() {
    const { tab } = this;
    const { name } = tab;
    if (this.warned !== name) {
      this.warned = name;
      tab.app.toast(UNTOUCHED);
      return;
    }
    await tab.saving.markUnchecked(name);
    if (tab.name === name) this.goNext();
  }

  /** Save the mean shape as it is, after asking. */
  async confirmLayout() {
    const { tab, marking } = this;
    const text = `No point of ${tab.name} was moved from the mean shape. The model will be trained on these points.`;
    if (!(await tab.app.confirm("Are the points right?", text, "Save the points", "primary"))) return;
    marking.accept();
    this.goNext();
  }

  skip() {
    if (this.marks) this.goNext();
  }

  async goNext() {
    const { tab } = this;
    const { name, state } = tab;
    const { saver } = tab.saving;
    this.warned = null;
    // The states of the pictures that are being saved are out of date.
    const known = state.project.pictures.filter((picture) => picture.name === name || !saver.isDirty(picture.name));
    const next = nextToTeach(known, name);
    if (next) {
      state.select(next.name);
      tab.viewer.canvas.focus({ preventScroll: true });
      return;
    }
    tab.leavePicture(name);
    await saver.flush(); // updates the states of the pictures
    const left = unfinished(state.project);
    tab.app.toast(left || "All pictures are done. Open Fit to try the model.", left ? "info" : "good");
  }
}
