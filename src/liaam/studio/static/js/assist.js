// The model's help: training in the background, and the choice of the next picture.

import { DONE_KEY, percent, several } from "./annotate-words.js";
import { openIn } from "./strip-filters.js";
import { button, dialog, h, icon, listOf } from "./ui.js";

const LEAST = 3; // pictures with which training can be asked for
const AUTO_FIRST = 4; // done pictures after which the first model is trained automatically: the number that the page names
const FEWEST_PLACED = 3; // points that a picture needs for training, if others are absent
const AUTO_AGAIN = 3; // pictures completed or changed after which it is trained again
const SHOWN = 5; // slips that are listed before training
const SLIP = `Move what is wrong, or ${DONE_KEY} if all is right, which marks it as checked.`;
const OFFERED = "These are the points of the face model that comes with liaam.";
const AUTO_KEY = "liaam-studio:auto-train";
const countOf = (/** @type {Picture[]} */ pictures, ...states) => pictures.filter(({ state }) => states.includes(state)).length;

/** The pictures that a training uses, which may lack absent points, and those of them whose points look wrong. */
const forTraining = (/** @type {Picture[]} */ pictures) => pictures.filter(({ state, left_out: who, absent, placed }) =>
  state === "done" && !who && !(absent && placed < FEWEST_PLACED));
const slipped = (pictures) => forTraining(pictures).filter(({ slip }) => slip);

/** Whether a person placed, moved or confirmed at least half of the points, as for the error of models. */
const isOwn = (/** @type {Picture} */ { placed = 0, unconfirmed = 0 }) => 2 * unconfirmed <= placed;

/** Whether to train automatically. `failedAt`: the `situation` in which training last failed or was stopped.
 *  @param {Project} project; @param {{auto: boolean, failedAt?: string | null}} when */
export function shouldTrain(project, { auto, failedAt = null }) {
  const { model, training, pictures } = project;
  if (project.set_aside) return false; // a person went back to the face model
  if (!auto || !project.template || training?.state === "running") return false;
  if (model && !["studio", "face"].includes(model.source)) return false; // a model given by the user is replaced only on request
  if (project.checked === false) return false; // possible slips are left out
  // Points of the face model that were only accepted would put a model of these few faces in its place.
  const taught = forTraining(pictures).filter((picture) => !picture.slip && (model?.source !== "face" || isOwn(picture)));
  if (taught.length < AUTO_FIRST || situation(project) === failedAt) return false;
  // One side that is stated may tell those of all pictures.
  return !model || model.sides_changed || model.stale >= AUTO_AGAIN;
}

/** When the first model places points, as a sentence. @param {Project} project; @param {{auto: boolean, failedAt?: string | null}} when */
export function whenItHelps(project, when) {
  const more = AUTO_FIRST - forTraining(project.pictures).length;
  if (more > 0) return `After ${several(more, "more picture")} the model can place points for you.`;
  const begins = shouldTrain({ ...project, checked: true }, when); // once the landmarks have been checked
  return begins || project.training?.state === "running" ? "After training, the model places points for you."
    : "Train the model to let it place points for you.";
}

/** Key of the training data: training on the same data would fail again. */
export const situation = (/** @type {Project} */ { model, pictures }) =>
  JSON.stringify([forTraining(pictures).map(({ name }) => name), model?.stale ?? null]);

/** What is not done yet, as a sentence; "" if all shown pictures are done without a possible slip, and the model was trained
 *  on all of them. @param {Pick<Project, "pictures" | "model">} shown */
export function unfinished({ pictures, model }) {
  const broken = countOf(pictures, "broken");
  const open = pictures.length - countOf(pictures, "done") - broken;
  const left = pictures.map(({ name }) => name).filter((name) => name in (model?.left_out ?? {}));
  const slips = slipped(pictures).length;
  const parts = [
    open && `${several(open, "picture")} ${open === 1 ? "is" : "are"} not done`,
    broken && `${several(broken, "picture")} cannot be read`,
    slips && `${several(slips, "picture")} ${slips === 1 ? "has" : "have"} a possible slip`,
    left.length && `the model leaves out ${left.length === 1 ? left[0] : several(left.length, "picture")}`,
  ].filter(Boolean);
  const text = parts.join(", and ");
  return text && `${text[0].toUpperCase()}${text.slice(1)}.`;
}

export const allDone = (folder) => (folder ? `All pictures of ${folder} are done.` : "All pictures are done.");

/** The next picture to open: the worst other one if the list is sorted by quality, or else nextToTeach. */
export function nextOf(state, pictures) {
  if (!state.worstFirst) return nextToTeach(pictures, state.current);
  const known = new Set(pictures.map(({ name }) => name));
  const listed = state.order.filter((name) => known.has(name) && name !== state.current);
  return openIn(listed.map((name) => state.picture(name)))[0] ?? null;
}

/** The picture that helps the model most: by rank, then by position after `current`; null if all are done. Those in which
 *  nothing is found come last.
 *  @param {Picture[]} pictures; @param {string | null} current; @returns {Picture | null} */
export function nextToTeach(pictures, current) {
  const at = pictures.findIndex((picture) => picture.name === current);
  const round = [...pictures.slice(at + 1), ...pictures.slice(0, Math.max(at, 0))];
  const ofState = (...states) => round.filter((picture) => states.includes(picture.state));
  const waiting = ofState("new", "partial", "proposed");
  const useful = waiting.filter(({ nothing_found: nothing }) => !nothing);
  const open = [useful, waiting].find(({ length }) => length) ?? ofState("unchecked");
  const rank = (picture) => picture.rank ?? Infinity;
  return open.reduce((best, picture) => (best === null || rank(picture) < rank(best) ? picture : best), null);
}

/** What to do with a picture in which the model finds no object. @param {Pick<Model, "source"> | null} model */
function nothingIn(model) {
  const is = model?.source === "face" ? "face" : "object";
  return `No ${is} was found in this picture. If there is none, skip it, or remove it: select it in the list and press Delete. If there is one, place its points.`;
}

const uncertain = (fraction) => (fraction <= 1 ? percent(fraction) : "over 100\u00a0%");

/** Why a picture comes next. @param {Picture | null} picture; @param {Picture[]} pictures; @param {Model | null} model */
export function reason(picture, pictures, model) {
  if (!picture) return "";
  if (!model) return "Next in the folder. Once there is a model, the picture that helps it most comes first.";
  if (picture.slip) return `Possible slip: ${picture.slip}.`;
  if (picture.state === "partial") return picture.proposed
    ? `${several(picture.proposed, "point")} of it ${picture.proposed === 1 ? "is" : "are"} still as proposed: correct ` +
      `what is wrong, then ${DONE_KEY}.` : "Some of its points are missing.";
  if (picture.state === "unchecked") return "Its points are still the mean shape, so no model is trained on it.";
  if (picture.nothing_found) return nothingIn(model);
  if (picture.uncertainty == null) return "The model has not been fitted to it yet.";
  const text = `uncertainty of its points: ${uncertain(picture.uncertainty)} of the object's size`;
  const isFace = model.source === "face";
  if (picture.doubtful) return `The model has low confidence here (${text}): if there is no ${isFace ? "face" : "object"}, skip or remove the picture. Else correct it, which helps most.`;
  // Compare with confident fits only: the uncertainty of the others is unreliable.
  const known = pictures
    .filter((each) => each.uncertainty != null && !each.doubtful && each.state !== "done")
    .map((each) => each.uncertainty)
    .sort((a, b) => a - b);
  if (known.length < 2 || picture.uncertainty < known.at(-1)) return `${text[0].toUpperCase()}${text.slice(1)}.`;
  const median = known[Math.floor((known.length - 1) / 2)];
  return `The least certain of the remaining pictures that are not doubtful (${text}, median ${uncertain(median)}).`;
}

/** Notices about the folder and the model: [{title, lines}], without empty ones. A line is a text, or {name, why} about a
 *  picture. @param {Project} project */
export function notices({ model, template, pictures = [], problems = [] }) {
  const left = Object.entries(model?.left_out ?? {}).map(([name, why]) => ({ name, why }));
  const groups = [
    { title: "Other template", lines: [mismatch({ model, template })].filter(Boolean) },
    { title: "Possible slips", lines: slipped(pictures).map(({ name, slip }) => ({ name, why: slip })) },
    { title: "Left out of training", lines: left },
    { title: "In the folder", lines: problems },
  ];
  return groups.filter(({ lines }) => lines.length);
}

/** Message if the model was trained for another template, otherwise "". @param {Pick<Project, "model" | "template">} project */
export function mismatch({ model, template }) {
  if (!model || !template || model.n_points === template.names.length) return "";
  const [has, wants] = [model.n_points, template.names.length];
  const remedy = "train again, or use the model in a folder with its template";
  return `The model has ${has} points where the template has ${wants}, so it cannot place points here: ${remedy}.`;
}

/** {element, notes: of notices, offerLayout(on): whether the points may be right at the mean shape, left(): a picture was
 *  left}; onexport(): choose what all landmarks are exported to. @param {App} app */
export function createAssist(app, commands, onexport) {
  const { api, state } = app;
  let failedAt = null;
  let asking = false;
  let noted = "";
  let known = null; // the pictures that were left out of training, once all states are known

  const count = h("p.assist-count");
  const progress = h("progress.progress", { "aria-label": "Training", max: 100 });
  const what = h("p.small.muted", { role: "status" });
  const cancel = button("Cancel", { small: true, kind: "ghost", testid: "training-cancel", onclick: stop });
  const running = h("div.assist-running", { testid: "training-progress", hidden: true }, progress, what, cancel);
  const failure = h("p.small.error-text", { role: "alert", hidden: true });
  const train = button("Train", {
    icon: "brain", small: true, testid: "train", onclick: async () => (await mayTrain()) && start(true),
  });
  const auto = h("input", {
    type: "checkbox", "aria-label": "Train automatically", checked: localStorage.getItem(AUTO_KEY) !== "off", testid: "auto-train",
    onchange: () => {
      localStorage.setItem(AUTO_KEY, auto.checked ? "on" : "off");
      refresh();
    },
  });
  const often = (isFace) => (isFace
    ? `once a person has placed, moved or confirmed (Y) half of the points of ${AUTO_FIRST} pictures: until then, the face model stays`
    : `when ${AUTO_FIRST} pictures are done, and again after every ${AUTO_AGAIN} more`);
  const autoLabel = h("label.check.small", auto, "auto");
  const next = button(state.readOnly ? "Next picture" : "Accept and continue", {
    icon: "check", kind: "primary", shortcut: "Enter", testid: "accept-next", onclick: commands.accept,
    title: "Accept these points and open the picture with the star",
  });
  next.append(h("kbd.kbd", { "aria-hidden": "true" }, "⏎"));
  const pass = button("Skip", {
    small: true, kind: "ghost", shortcut: "N", testid: "skip-next", onclick: commands.skip,
    title: "Open the next picture and leave this one unchanged",
  });
  const sure = button("The points are right…", {
    small: true, testid: "confirm-layout", onclick: commands.confirmLayout,
    title: "Save the mean shape although no point was moved",
  });
  const why = h("p.small.muted", { testid: "why-next" });
  const notes = h("section.panel.assist-notes", { hidden: true, "aria-label": "Notices", testid: "notices" });
  const go = (label, testid, work) => button(label, { small: true, testid: `then-${testid}`, onclick: work });
  const end = h("div.column.assist-end", { hidden: true },
    h("p", icon("check"), " All pictures are done. What next?"),
    h("div.row", go("Check", "review", () => app.list.review()),
      go("Measure", "measure", () => app.openTab("measure")), go("Export", "export", onexport),
      go("Fit", "fit", () => app.openTab("fit")), go("Live", "live", () => app.openTab("live"))));
  const decline = () => api.delete(api.url("model/face")).then(() => state.refresh());
  const other = button("Use other points…", {
    small: true, hidden: true, testid: "decline-face", onclick: decline, title: "Make a template of your own",
  });
  const use = (source) => state.send((folder) => api.put(api.url("model"), { source, folder })).then(() => state.refresh());
  const again = button("Use the face model again", {
    small: true, kind: "ghost", hidden: true, testid: "face-again",
    title: "Let the face model that comes with liaam place points, instead of that of this folder. All landmarks stay",
    onclick: async () => {
      await use("face");
      app.toast("The face model places points again. Train uses a model of this folder.", "good", { label: "Undo", onclick: () => use("studio") });
    },
  });
  const element = h("section.panel.assist", { "aria-label": "The model's help" },
    h("div.row.assist-head", icon("spark"), count, h("span.grow"),
      autoLabel, train),
    h("div.row.assist-go", next, pass),
    h("div.assist-talk",
      h("div.assist-words", { tabindex: "0", role: "group", "aria-label": "What to do next" }, why, failure, end),
      running, sure, other, again));

  async function mayTrain() {
    const wrong = slipped(state.project.pictures);
    if (!wrong.length) return true;
    const lines = wrong.slice(0, SHOWN).map(({ name, slip }) => `${name}: ${slip}`);
    const advice = h("p.small.muted", "Show “Slips” in the list for all. Pictures that are marked as checked are not among them.");
    const title = `Points of ${several(wrong.length, "picture")} may be wrong`;
    const answer = await dialog(title, h("div", listOf(lines), advice), [
      { label: "Train anyway", value: "train" },
      { label: "Look at them", kind: "primary", value: "look", testid: "look-at-slips" },
    ]);
    if (answer === "look") state.select(wrong[0].name);
    return answer === "train";
  }

  /** slips: whether to train on points that look wrong, too. */
  async function start(slips) {
    if (asking) return;
    asking = true;
    fail("");
    try {
      state.takeWork("training", await state.send((folder) => api.post(api.url("training"), { folder, slips })));
    } catch (error) {
      // 409: another tab has started the training already. 422: it cannot start with this data.
      if (error.status !== 409) fail(error.message, error.status === 422);
      if (![409, 422].includes(error.status)) known = null; // try again when the server answers
    } finally {
      asking = false;
      refresh();
    }
  }

  async function stop() {
    cancel.disabled = true;
    failedAt = situation(state.project); // do not restart automatically what the user has stopped
    const request = state.send((folder) => api.delete(api.url("training"), { folder }));
    await request.finally(() => { cancel.disabled = false; });
  }

  /** Show why training failed, and do not retry automatically if it is for good; "": it did not fail. */
  function fail(text, forGood = true) {
    if (text && forGood) failedAt = situation(state.project);
    failure.textContent = text;
    failure.hidden = !text;
  }

  function note(project) {
    const groups = notices(project);
    if (JSON.stringify(groups) === noted) return; // keep an opened list open
    noted = JSON.stringify(groups);
    notes.hidden = !groups.length;
    notes.replaceChildren(...groups.map(({ title, lines }) => (lines.length === 1 ? h("p.small", noticed(lines[0]))
      : h("details.small", h("summary", `${title}: ${lines.length} notices`), listOf(lines.map(noticed))))));
  }

  /** A line of a notice, which opens the picture that it is about. */
  function noticed(line) {
    if (typeof line === "string") return line;
    const open = h("button.link", { type: "button", testid: "notice", onclick: () => state.select(line.name) }, line.name);
    return [open, `: ${line.why}`];
  }

  function refresh() {
    const { project } = state;
    if (!project) return;
    const { pictures, model, training } = project;
    const usable = pictures.length - countOf(pictures, "broken");
    const left = Object.keys(model?.left_out ?? {}).length;
    count.textContent = `${countOf(pictures, "done") - left} of ${usable} done${left ? `, ${left} left out` : ""}`;
    count.title = left ? "Left out of training: the notices below say why" : "";
    const done = forTraining(pictures).length;
    element.hidden = !project.template;
    const isOffered = Boolean(project.offered) && model?.source === "face";
    other.hidden = !isOffered;
    const runs = training?.state === "running";
    again.hidden = !project.face_again || runs;
    running.hidden = !runs;
    const { total = 0, done: ready = 0, what: doing = "" } = training ?? {};
    if (total) progress.value = Math.round((100 * ready) / total);
    else progress.removeAttribute("value");
    // Most steps are not about one picture, and their names have no room here.
    what.textContent = !runs ? "" : total ? `Training, ${progress.value} %` : "Training…";
    what.title = doing;
    train.disabled = runs || asking || done < LEAST;
    const stale = model?.stale && `${several(model.stale, "picture")} completed or changed since the last training`;
    const isFace = model?.source === "face";
    autoLabel.title = `Train automatically: ${often(isFace)}`;
    const early = isFace ? `Train a model of your own pictures, from ${LEAST} done ones on, in place of the face model`
      : whenItHelps(project, { auto: auto.checked });
    train.title = done < LEAST ? early : stale || "Train the model on all done pictures";
    train.classList.toggle("primary", !model && done >= LEAST && !runs && !auto.checked);
    end.hidden = !pictures.length || done < LEAST || nextToTeach(pictures, null) !== null || slipped(pictures).length > 0;
    next.disabled = !end.hidden; // there is nothing to accept and no picture to continue with
    explain(project, done);
    if (isOffered) why.textContent = `${OFFERED} ${why.textContent}`;
    why.hidden = !end.hidden && why.textContent === allDone(state.folder);
    note(project);
  }

  /** @param {Project} project; @param {number} done */
  function explain({ pictures, model }, done) {
    const here = state.picture();
    const then = nextOf(state, state.pictures);
    const left = unfinished({ pictures: state.pictures, model });
    const without = model?.left_out?.[here?.name];
    // What to do comes first: the place is small.
    const slip = here?.slip && `${SLIP} Possible slip${without ? ", left out of training" : ""}: ${here.slip}.`;
    const leftOut = without && (here?.checked // by a person since
      ? "The model was trained without this picture. The next training uses it, since it is checked."
      : `The model leaves this picture out, because ${without}.`);
    const fault = slip || leftOut || (here?.state !== "broken" && here?.error); // the place of the picture says that
    pass.disabled = !then;
    why.classList.toggle("warn-text", Boolean(fault));
    const isOpen = here && here.state !== "done" && (here.uncertainty != null || here.nothing_found) && model;
    const ended = left || (done ? allDone(state.folder) : "");
    const next = !then ? ended : model ? `Next: ${then.name}. ${reason(then, pictures, model)}`
      : whenItHelps(state.project, { auto: auto.checked || asking, failedAt });
    why.textContent = fault || (isOpen ? reason(here, pictures, model) : next);
    why.title = why.textContent;
  }

  /** Train between two pictures, when no point is being moved. */
  async function left() {
    known = null; // train once the landmarks have been checked
    await state.refresh().catch(() => {});
    watch();
  }

  /** Train on opening, once the states of all pictures are known, and when pictures are left out or taken in, or a side is
   *  stated. */
  function watch() {
    const { pictures, training, checked, model } = state.project;
    if (asking || training?.state === "running" || !checked || pictures.some(({ state: is }) => is === "reading")) return;
    const without = pictures.filter(({ left_out: who }) => who).map(({ name }) => name);
    const now = JSON.stringify([without, model?.sides_changed ? model.number : null]);
    if (now !== known && shouldTrain(state.project, { auto: auto.checked, failedAt })) start(false);
    known = now;
  }

  state.addEventListener("training", (/** @type {any} */ event) => {
    /** @type {Training} */
    const detail = event.detail;
    if (detail.state === "failed") fail(detail.error ?? "Training failed.");
    else if (detail.state !== "idle") fail("");
    if (detail.state === "done") failedAt = null;
    refresh();
  });
  for (const event of ["project", "select", "folder"]) state.addEventListener(event, refresh);
  state.addEventListener("project", watch);
  refresh();
  watch();
  /** A button for points that are right at the mean shape. It is where the messages are, whose room stays. */
  const offerLayout = (on) => { sure.hidden = !on; };
  return { element, notes, offerLayout, left };
}
