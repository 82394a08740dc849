// The model's help: training while the person goes on, and which picture to correct next.

export const LEAST = 3; // pictures that training needs
export const AUTO_FIRST = 4; // done pictures from which the first model is trained unasked
export const AUTO_AGAIN = 3; // pictures completed or changed since, from which it is trained again
const AUTO_KEY = "liaam-studio:auto-train";

export const countDone = (pictures) => pictures.filter((picture) => picture.state === "done").length;

/** Whether to train without being asked. `failedAt`: what `situation` was when training last failed or was stopped. */
export function shouldTrain(project, { auto, failedAt = null }) {
  const { model, training, pictures } = project;
  if (!auto || !project.template || training?.state === "running") return false;
  if (model?.source === "file") return false; // the person brought this model: replacing it is theirs to ask for
  if (countDone(pictures) < AUTO_FIRST || situation(project) === failedAt) return false;
  return !model || model.stale >= AUTO_AGAIN;
}

/** What would be trained on: the same again would fail again. */
export const situation = ({ model, pictures }) => `${countDone(pictures)}|${model?.stale ?? "none"}`;

/** The picture that teaches most of those that are not done: by rank, then by place in the folder, after `current`. */
export function nextToTeach(pictures, current) {
  const at = pictures.findIndex((picture) => picture.name === current);
  const round = [...pictures.slice(at + 1), ...pictures.slice(0, Math.max(at, 0))];
  const open = round.filter((picture) => ["new", "partial", "proposed"].includes(picture.state));
  const rank = (picture) => picture.rank ?? Infinity;
  return open.reduce((best, picture) => (best === null || rank(picture) < rank(best) ? picture : best), null);
}

const NBSP = "\u00a0";

/** A share for people; beyond the object's own size a number says nothing. */
function percent(share) {
  if (!(share <= 1)) return `over 100${NBSP}%`;
  return `${(100 * share).toFixed(share < 0.01 ? 2 : 1)}${NBSP}%`;
}

/** Why this picture comes next, in one sentence. */
export function reason(picture, pictures, model) {
  if (!picture) return "";
  if (!model) return "Next in the folder; once there is a model, the picture that teaches it most comes first.";
  if (picture.state === "partial") return "Some of its points are still missing.";
  if (picture.uncertainty == null) return "The model has not looked at it yet.";
  const sure = `its points are uncertain by ${percent(picture.uncertainty)} of the object's size`;
  if (picture.doubtful) return `The model doubts its own points here (${sure}), so correcting them teaches most.`;
  // Only with its like can it be compared: where the model doubts its points, so it does how sure they are.
  const known = pictures
    .filter((each) => each.uncertainty != null && !each.doubtful && each.state !== "done")
    .map((each) => each.uncertainty)
    .sort((a, b) => a - b);
  if (known.length < 2 || picture.uncertainty < known.at(-1)) return `${sure[0].toUpperCase()}${sure.slice(1)}.`;
  const median = known[Math.floor((known.length - 1) / 2)];
  return `Of those left, the model is least sure here: ${sure} (half of them: at most ${percent(median)}).`;
}

/** What a person should know of the folder and the model: [{title, lines}], without what there is nothing to say of. */
export function notices({ model, template, problems = [] }) {
  const left = Object.entries(model?.left_out ?? {}).map(([name, why]) => `${name}: ${why}`);
  const groups = [
    { title: "Not as the template", lines: [mismatch({ model, template })].filter(Boolean) },
    { title: "Left out of the model", lines: left },
    { title: "In the folder", lines: problems },
  ];
  return groups.filter(({ lines }) => lines.length);
}

/** What is wrong where the model was made for another template, in a sentence; "" where nothing is. */
export function mismatch({ model, template }) {
  if (!model || !template || model.n_points === template.names.length) return "";
  const [has, wants] = [model.n_points, template.names.length];
  const remedy = "train it anew, or open it in a folder of its template";
  return `The model has ${has} points where the template has ${wants}, so it cannot place points here: ${remedy}.`;
}

/**
 * The panel. parts: {app, oneditable, accept(): take over what is shown and go on; skip(): go on without}.
 * Gives {element, refresh(), left(): the person is done with a picture for now}.
 */
export function createAssist({ app, accept, skip }) {
  const { h, button, icon } = app.ui;
  const { state, api } = app;
  let failedAt = null;
  let asking = false;

  const count = h("p", { class: "assist-count" });
  const bar = h("span");
  const progress = h(
    "div",
    { class: "progress", role: "progressbar", "aria-label": "Training", "aria-valuemin": "0", "aria-valuemax": "100" },
    bar,
  );
  const what = h("p", { class: "small muted", role: "status" });
  const cancel = button("Cancel", { small: true, kind: "ghost", testid: "training-cancel", onclick: stop });
  const running = h(
    "div",
    { class: "column assist-running", dataset: { testid: "training-progress" }, hidden: true },
    progress,
    h("div", { class: "row" }, h("div", { class: "grow" }, what), cancel),
  );
  const failure = h("p", { class: "small error-text", role: "alert", hidden: true });
  const train = button("Train", { icon: "brain", small: true, testid: "train", onclick: start });
  const auto = h("input", {
    type: "checkbox",
    checked: localStorage.getItem(AUTO_KEY) !== "off",
    dataset: { testid: "auto-train" },
    onchange: () => localStorage.setItem(AUTO_KEY, auto.checked ? "on" : "off"),
  });
  const autoLabel = h(
    "label",
    {
      class: "check small",
      title: `Trains when ${AUTO_FIRST} pictures are done, and again after every ${AUTO_AGAIN} more`,
    },
    auto,
    "Train by itself",
  );
  const next = button("Accept, go on", {
    icon: "check",
    kind: "primary",
    shortcut: "Enter",
    testid: "accept-next",
    onclick: accept,
    title: "Accept these points, open the picture that teaches most",
  });
  next.append(h("kbd", { class: "kbd", "aria-hidden": "true" }, "⏎"));
  const pass = button("Skip", {
    small: true,
    kind: "ghost",
    shortcut: "N",
    testid: "skip-next",
    onclick: skip,
    title: "Next picture, this one stays as it is",
  });
  const why = h("p", { class: "small muted", dataset: { testid: "why-next" } });

  const notes = h("div", { class: "column assist-notes", hidden: true, dataset: { testid: "notices" } });
  let noted = "";

  const element = h(
    "section",
    { class: "panel assist", "aria-label": "The model's help" },
    h("div", { class: "row assist-head" }, icon("spark"), count, h("span", { class: "grow" }), train),
    running,
    failure,
    h("div", { class: "row assist-go" }, next, pass),
    why,
    notes,
    autoLabel,
  );

  async function start() {
    if (asking) return;
    asking = true;
    failure.hidden = true;
    try {
      const training = await state.send((folder) => api.post(api.url("training"), { folder }));
      state.project.training = training;
    } catch (error) {
      // Another tab was quicker: its training is ours too.
      if (error.status !== 409) {
        failedAt = situation(state.project);
        showFailure(error.message);
      }
    } finally {
      asking = false;
      refresh();
    }
  }

  async function stop() {
    cancel.disabled = true;
    failedAt = situation(state.project); // who stops it does not want it begun again by itself
    try {
      await state.send((folder) => api.delete(api.url("training"), { folder }));
    } catch (error) {
      app.toast(error, "bad");
    } finally {
      cancel.disabled = false;
    }
  }

  /** Long lists stay closed: their titles say that there is something, and how much. */
  function note(project) {
    const groups = notices(project);
    const key = JSON.stringify(groups);
    if (key === noted) return; // one that was opened stays so
    noted = key;
    notes.hidden = !groups.length;
    notes.replaceChildren(
      ...groups.map(({ title, lines }) =>
        lines.length === 1
          ? h("p", { class: "small" }, lines[0])
          : h(
              "details",
              { class: "small" },
              h("summary", {}, `${title}: ${lines.length} remarks`),
              h("ul", { class: "assist-lines" }, lines.map((line) => h("li", {}, line))),
            ),
      ),
    );
  }

  function showFailure(text) {
    failure.textContent = text;
    failure.hidden = !text;
  }

  function refresh() {
    const { project } = state;
    if (!project) return;
    const { pictures, model, training } = project;
    const done = countDone(pictures);
    const usable = pictures.filter((picture) => picture.state !== "broken").length;
    count.textContent = `${done} of ${usable} done`;
    element.hidden = !project.template;
    const runs = training?.state === "running";
    running.hidden = !runs;
    if (runs) showProgress(training);
    train.disabled = runs || asking || done < LEAST;
    train.title =
      done < LEAST
        ? `Needs ${LEAST} pictures that are done; ${done} ${done === 1 ? "is" : "are"}`
        : model?.stale
          ? `${model.stale} ${model.stale === 1 ? "picture" : "pictures"} completed or changed since the last training`
          : "Train the model with all that is done";
    train.classList.toggle("primary", !model && done >= LEAST && !runs && !auto.checked);
    explain(pictures, model, done);
    note(project);
  }

  function showProgress({ phase, done, total, what: doing }) {
    const share = total ? Math.round((100 * done) / total) : null;
    progress.classList.toggle("unknown", share === null);
    bar.style.width = share === null ? "" : `${share}%`;
    if (share === null) progress.removeAttribute("aria-valuenow");
    else progress.setAttribute("aria-valuenow", String(share));
    const doingText = doing || (phase === "proposals" ? "Placing points on the other pictures" : "Training");
    what.textContent = total ? `${doingText} (${done} of ${total})` : `${doingText}…`;
  }

  function explain(pictures, model, done) {
    const here = state.picture();
    const then = nextToTeach(pictures, state.current);
    if (here && here.state !== "done" && here.uncertainty != null && model)
      why.textContent = reason(here, pictures, model);
    else if (then)
      why.textContent = model ? `Next: ${then.name}. ${reason(then, pictures, model)}` : progressText(done);
    else why.textContent = done ? "All pictures are done." : "";
    pass.disabled = !then;
  }

  function progressText(done) {
    const left = AUTO_FIRST - done;
    if (left > 0)
      return `After ${left} more ${left === 1 ? "picture" : "pictures"} the model can place points for you.`;
    if (state.project.training?.state === "running") return "Once this is done, the next pictures come with points.";
    return "Train the model, and it places the points of the next pictures.";
  }

  /** Between two pictures is the time to train: what was being moved is in place. */
  async function left() {
    await state.refresh().catch(() => {});
    if (shouldTrain(state.project, { auto: auto.checked, failedAt })) await start();
  }

  state.addEventListener("training", ({ detail }) => {
    if (detail.state === "failed") {
      failedAt = situation(state.project);
      showFailure(detail.error ?? "Training failed.");
    } else if (detail.state === "done") {
      failedAt = null;
    }
    if (detail.state === "running" || detail.state === "done") showFailure("");
    refresh();
  });
  state.addEventListener("project", refresh);
  state.addEventListener("select", refresh);
  refresh();
  return { element, refresh, left };
}
