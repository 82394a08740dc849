// Commands of the Annotate tab's buttons and keys.

import { called, missingText, several, UNTOUCHED } from "./annotate-words.js";
import { allDone, nextOf, unfinished } from "./assist.js";
import { act } from "./bulk.js";
import { placed } from "./points.js";

const NOT_MIRRORED = "The template has no mirrored points. Mirror pairs new points only: add them with Mirror on, or " +
  "load a template with left and right in its names.";
const ALL_STAY = "All points of this curve are placed landmarks, and only semilandmarks are moved by tracing and " +
  "spacing. Edit the template to make points between the ends semilandmarks.";
const EDGE = 20; // css pixels; a point closer to the border of the view is scrolled into it

/** @param {import("./annotate.js").Tab} tab */
export function createCommands(tab) {
  const { app, state, marking, viewer, say } = tab;
  let escaped = false; // whether Tab leaves the picture
  let warned = null; // picture with a warning about missing points
  let accepted = null; // {name, next}: the picture that was accepted last, and the one that was opened after it
  let closeWarning = () => {};

  function reveal(index) {
    tab.sayPlace(index);
    const point = marking.points[index];
    if (!point) return;
    const [x, y] = viewer.toScreen(point);
    const { clientWidth: w, clientHeight: h } = viewer.container;
    if (x < EDGE || y < EDGE || x > w - EDGE || y > h - EDGE) viewer.panBy(w / 2 - x, h / 2 - y);
  }

  function warn(text) {
    warned = tab.name;
    closeWarning = app.toast(text);
  }

  /** Go on once work(name) has marked the picture as it is; false: it has not. */
  async function goOnAfter(work) {
    const { name } = tab;
    if ((await work(name)) !== false && tab.name === name) goNext(true);
  }

  /** The person has checked points that look wrong, and were left as they are. */
  const passSlip = async (name) => (await act(app, "checked", [name])).length > 0;

  async function goNext(accepts = false) {
    const { name, saver } = tab;
    warned = null;
    closeWarning();
    // The states of the pictures that are being saved are out of date.
    const known = state.pictures.filter((picture) => picture.name === name || !saver.isDirty(picture.name));
    const next = nextOf(state, known);
    if (next) {
      accepted = accepts ? { name, next: next.name } : null;
      state.select(next.name);
      return tab.focus();
    }
    tab.leavePicture(name);
    await saver.flush(); // updates the states of the pictures
    const left = unfinished({ pictures: state.pictures, model: state.project.model });
    app.toast(left || `${allDone(state.folder)} Open Fit to try the model.`, left ? "info" : "good");
  }

  function toChosen(work) {
    const chosen = tab.tracing.on ? [] : marking.chosenPlaced;
    if (chosen.length) say(`${called(marking.names, chosen)} ${work()}`);
  }

  /** Work on the contour of the selected or next point, and say what work() returns. */
  function toContour(work) {
    const { wanted } = tab.tracing;
    if (wanted && !tab.tracing.mayChange(wanted)) return void app.toast(ALL_STAY);
    if (wanted) say(work(wanted));
    else app.toast("Select a point of a curve that has three points or more. Draw curves in the template (Edit template…).");
  }

  const commands = {
    /** Whether Tab leaves the picture. */
    get escaped() { return escaped; },

    /** Other points were selected, so that Tab selects points again. */
    stay() { escaped = false; },

    get marks() { return !tab.editing && marking.book !== null; },

    /** Whether another picture can be opened: one is open, or cannot be opened. */
    get goesOn() { return !tab.editing && tab.name !== null && (marking.book !== null || tab.opening.isCovered); },

    flick(what) {
      tab.shown.toggle(what);
    },

    /** Show the open picture mirrored, or as it is; the page remembers which ones. */
    mirrorView() {
      viewer.mirror(tab.shown.toggleMirrored(tab.name));
      say(viewer.mirrored ? "Shown mirrored" : "Shown as it is");
    },

    hideMarks(on) {
      if (marking.hidden === on) return;
      marking.hide(on);
      viewer.redraw();
    },

    toggleBox() {
      tab.toolbar.press("box", tab.tool.toggleBoxes());
    },

    toggleMirrored() {
      if (!tab.template?.mirror) return void app.toast(NOT_MIRRORED);
      marking.toggleMirrored();
      tab.toolbar.press("mirror", marking.mirrored);
      say(marking.mirrored ? "Mirrored points move together" : "Points move separately");
    },

    chooseFromList(index, adds) {
      const { chosen } = marking;
      if (!adds) marking.select([index]);
      else marking.select(chosen.includes(index) ? chosen.filter((i) => i !== index) : [...chosen, index]);
      reveal(index);
    },

    chooseAll() {
      tab.doc.select(placed(tab.doc.points), -1);
      say(`${several(tab.doc.selection.size, "point")} selected`);
    },

    ruler: () => tab.ruler.start(),

    /** Measure the selected points in all pictures; with none selected, show or hide the measures. */
    async measure() {
      if (tab.drawing) return;
      const inOrder = [...marking.selection].filter((i) => marking.points[i]); // as they were selected
      if (inOrder.length > 1) {
        const added = await tab.measured.add(inOrder);
        return void app.toast(`${added}, in all pictures.`, "good", { label: "Show all", onclick: () => app.openTab("measure") });
      }
      say(tab.shown.toggle("measures") ? "Measures shown" : "Measures hidden");
    },

    /** Trace the contour of the selected or next point; again: end it, or stop if it has too few places. */
    trace() {
      const { tracing } = tab;
      if (tracing.on) return tracing.whole ? tracing.finish() : tracing.turn(false);
      tab.drawing?.turn(false);
      toContour((contour) => {
        tracing.turn(contour); // first, since undo brings back what is selected now
        marking.select([]);
        return tracing.prompt;
      });
    },

    space: () => toContour((contour) => {
      tab.tracing.space(contour);
      return "The points of the curve are evenly spaced";
    }),

    escape() {
      tab.tool.cancel();
      tab.drawing?.turn(false);
      marking.select([]);
      escaped = true;
    },

    /** Select the next or previous point; false if there is none, so that the focus leaves the picture. */
    stepPoint(by) {
      const index = marking.step(by);
      if (index >= 0) reveal(index);
      return index >= 0;
    },

    /** The picture that was accepted before this one, to which undo returns while nothing was changed here; or null. */
    get cameFrom() {
      const isBack = !tab.editing && !tab.drawing && accepted?.next === tab.name && !marking.history?.canUndo;
      return isBack && state.picture(accepted.name) ? accepted.name : null;
    },

    travel(way) {
      tab.tool.cancel();
      const { cameFrom } = commands;
      if (way === "undo" && cameFrom) {
        accepted = null;
        state.select(cameFrom);
        return say(`Back to ${cameFrom}, which was accepted`);
      }
      const what = tab.doc.travel(way);
      if (what !== null) tab.tool.leave(); // its loupe would stay where the point was
      if (what !== null) say(`${way === "undo" ? "Undone" : "Redone"}: ${what}`);
    },

    flip() {
      marking.flip();
      say("Flipped left and right");
    },

    /** Confirm the selected point where it is, and show the next to be confirmed. */
    confirm() {
      if (tab.drawing) return;
      const index = marking.confirm();
      if (index < 0) return void app.toast("Select a single point with a position to confirm it.");
      say(`${marking.names[index]} confirmed`);
      if (marking.active !== index) reveal(marking.active);
    },

    toggleAbsent() {
      if (tab.drawing) return;
      const what = called(marking.names, marking.chosen);
      const isAbsent = marking.toggleAbsent();
      if (isAbsent !== null) say(`${what} ${isAbsent ? "absent: this object does not have it" : "missing"}`);
    },

    toggleInvisible: () => toChosen(() => (marking.toggleInvisible() ? "invisible" : "visible")),

    removeChosen: () => toChosen(() => {
      marking.removeChosen();
      return "cleared";
    }),

    /** Take the points of the nearest done picture before this one, as in a series; they are then as proposed. */
    async copyPrevious() {
      if (tab.drawing) return;
      const { name } = tab;
      const before = state.order.slice(0, Math.max(state.order.indexOf(name), 0));
      const from = before.findLast((each) => state.picture(each)?.state === "done");
      if (!from) return void app.toast("No picture before this one in the list is done.");
      const marks = await tab.saving.fetchMarks(from);
      if (tab.name !== name || !commands.marks || marks.points.length !== marking.points.length) return;
      const take = (point, i) => (marking.absent.includes(i) ? null : (point ?? marking.points[i]));
      marking.change({ points: marks.points.map(take) }, `copy from ${from}`, null, { fresh: "proposed", changed: "proposed" });
      say(`Points copied from ${from}`);
    },

    placeChosen() {
      const index = marking.placeChosen(viewer);
      if (index >= 0) tab.sayPlace(index);
    },

    accept() {
      if (!commands.marks || marking.locked) return commands.skip(); // there is nothing to accept
      if (tab.tracing.on) return tab.tracing.finish();
      if (marking.state.source === "layout") // left as it is
        return void (warned === tab.name ? goOnAfter(tab.saving.markUnchecked) : warn(UNTOUCHED));
      const isSlip = state.picture(tab.name)?.slip && marking.isAsOpened;
      marking.accept();
      const left = marking.missing;
      if (!left.length || warned === tab.name) return void (isSlip ? goOnAfter(passSlip) : goNext(true));
      marking.select([left[0]]);
      return warn(missingText(marking.names, left)); // once, since points may be left out on purpose
    },

    async confirmLayout() {
      const text = `No point of ${tab.name} was moved from the mean shape. The model will be trained on these points.`;
      if (!(await app.confirm("Are the points right?", text, "Save the points", "primary"))) return;
      marking.accept();
      goNext(true);
    },

    skip() {
      if (commands.goesOn) goNext();
    },
  };
  return commands;
}
