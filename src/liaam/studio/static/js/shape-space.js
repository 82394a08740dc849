// The space of shapes: a scatter of principal components, the shapes over each other, and the thin-plate grid of a change.

import { numberText } from "./measures.js";
import { bentGrid, scatter, superimposed } from "./shape-plots.js";
import { button, h, labelledSlider, relist } from "./ui.js";

const OUTLIERS = 12; // unusual shapes that are named
const MOST_AXES = 10; // components that can be chosen
const SELECTED = "selected";
const MOST = 3; // standard deviations, or times a change, to which the slider goes

/** @param {import("./measure.js").Tab} tab */
export function createShapeSpace(tab) {
  const axes = { across: 0, upward: 1 };
  let change = "0"; // a component by index, "selected", or "a>b", groups by index
  let amount = 1;
  let known = null; // the selected shape that the change was set for

  const component = (which, label) => h("select.text", {
    "aria-label": label, testid: `shape-${which}`, onchange: (event) => { axes[which] = Number(event.target.value); draw(); },
  });
  const across = component("across", "Component across");
  const upward = component("upward", "Component upward");
  const what = h("select.text", { "aria-label": "Change", testid: "shape-change", onchange: () => { change = what.value; setAmount(); } });
  const { element: slider, show } = labelledSlider("Amount", (value) => { amount = value; draw(); }, {
    min: String(-MOST), max: String(MOST), step: "0.1", "aria-label": "Amount of the change", testid: "shape-amount", class: "row shape-amount",
  });
  const pca = h("div.measure-plot", { testid: "shape-scatter" });
  const cloud = h("div.measure-plot", { testid: "shape-cloud" });
  const grid = h("div.measure-plot", { testid: "shape-grid" });
  const unusual = h("div.row.tight.small", { testid: "shape-outliers" });
  const tests = h("ul.small.shape-tests", { testid: "shape-tests", "aria-label": "Differences between groups" });
  const why = h("p.muted", { testid: "shape-why-not" });
  const sides = h("p.muted.small", { testid: "shape-sides" });
  const cards = h("div.measure-cards.shape-cards",
    h("section.panel.measure-card.shape-main", { "aria-label": "Principal components" },
      h("div.row", h("h2.panel-title.grow", "Principal components"), across, "and", upward), pca, unusual, tests),
    h("section.panel.measure-card", { "aria-label": "Thin-plate grid" },
      h("div.row", h("h2.panel-title.grow", "Change as a grid"), what), slider, grid),
    h("section.panel.measure-card", { "aria-label": "Procrustes superimposition" },
      h("h2.panel-title", "All shapes, superimposed"), sides, cloud));
  const element = h("div.measure-view", why, cards);

  function setAmount() {
    amount = 1;
    draw();
  }

  /** Index of the selected picture among those that have a shape; -1 for none. */
  const chosenIn = (space) => space.of.indexOf(tab.chosen);

  const column = (space, c) => space.scores.map((row) => row[c]);
  const sd = (values) => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / Math.max(1, values.length - 1));

  /** Mean scores of a group. */
  function centreOf(space, group) {
    const own = space.scores.filter((_, i) => tab.groups.of[space.of[i]] === group);
    return space.axes.map((_, c) => own.reduce((sum, row) => sum + row[c], 0) / own.length);
  }

  /** The scores at which the grid is drawn, and how the change and its amount are called. */
  function asked(space) {
    const { names } = tab.groups;
    if (change === SELECTED) {
      const own = space.scores[chosenIn(space)] ?? space.axes.map(() => 0);
      return { scores: own.map((score) => amount * score), words: `× ${amount.toFixed(1)}`, called: `from the mean shape to ${tab.state.current}` };
    }
    if (change.includes(">")) {
      const [from, to] = change.split(">").map(Number);
      const [first, last] = [centreOf(space, from), centreOf(space, to)];
      return { scores: last.map((score, c) => amount * (score - first[c])), words: `× ${amount.toFixed(1)}`, called: `from ${names[from]} to ${names[to]}` };
    }
    const c = Number(change);
    const step = sd(column(space, c));
    return { scores: space.axes.map((_, i) => (i === c ? amount * step : 0)), words: `${amount.toFixed(1)} SD`, called: `along PC${c + 1}` };
  }

  function offer(space) {
    const some = space.shares.slice(0, MOST_AXES);
    const labels = Object.fromEntries(some.map((share, c) => [c, `PC${c + 1}, ${(100 * share).toFixed(0)} %`]));
    for (const which of ["across", "upward"]) axes[which] = Math.min(axes[which], some.length - 1);
    relist(across, labels, String(axes.across));
    relist(upward, labels, String(axes.upward));
    const { names, of } = tab.groups;
    const present = names.map((_, i) => i).filter((i) => space.of.some((picture) => of[picture] === i));
    const pairs = present.flatMap((a) => present.filter((b) => b > a).map((b) => [`${a}>${b}`, `${names[a]} to ${names[b]}`])).slice(0, 30);
    const changes = [...some.map((_, c) => [String(c), `Along PC${c + 1}`]), [SELECTED, "To the selected picture"], ...pairs];
    if (!changes.some(([value]) => value === change)) change = "0";
    // As in a plain object, keys that are numbers would come first, which they do.
    relist(what, Object.fromEntries(changes), change);
  }

  function drawOutliers(space) {
    const far = space.distances.map((value, i) => [value, i]).filter(([value]) => value > space.limit).sort((a, b) => b[0] - a[0]);
    const one = ([value, i]) => button(tab.data.pictures[space.of[i]], {
      small: true, title: `${numberText(value)} from the mean shape; unusual are those beyond ${numberText(space.limit)}`,
      testid: "shape-outlier", onclick: () => tab.choose(space.of[i]),
    });
    unusual.replaceChildren(far.length ? "Unusual shapes:" : h("span.muted", "No shape is unusually far from the mean."),
      ...far.slice(0, OUTLIERS).map(one), far.length > OUTLIERS ? `and ${far.length - OUTLIERS} more` : "");
    return new Set(far.map(([, i]) => i));
  }

  function draw() {
    const { data } = tab;
    const { space } = data;
    why.hidden = Boolean(space);
    cards.hidden = !space;
    sides.hidden = !data.sides;
    sides.textContent = data.sides && `${data.sides}.`;
    why.textContent = space ? "" : `Shapes are compared from three complete pictures on: ${data.why_not}.`;
    if (!space) return;
    const own = chosenIn(space);
    if (known !== tab.state.current && change === SELECTED) amount = 1;
    known = tab.state.current;
    offer(space);
    const far = drawOutliers(space);
    const groups = space.of.map((picture) => tab.groups.of[picture]);
    const names = space.of.map((picture) => data.pictures[picture]);
    const titles = [axes.across, axes.upward].map((c) => `PC${c + 1} (${(100 * space.shares[c]).toFixed(1)} %)`);
    pca.replaceChildren(scatter({
      points: space.scores.map((row) => [row[axes.across], row[axes.upward] ?? 0]), groups, chosen: own, unusual: far, titles, names,
      onpick: (i) => tab.choose(space.of[i]),
    }));
    const place = new Map(space.landmarks.map((landmark, i) => [landmark, i]));
    const contours = tab.contours.map(({ indices, closed }) =>
      ({ indices: indices.filter((i) => place.has(i)).map((i) => place.get(i)), closed }));
    cloud.replaceChildren(superimposed({ shapes: space.shapes, mean: space.mean, contours, chosen: space.shapes[own] ?? null, groups }));
    const { scores, words, called } = asked(space);
    show(amount, words);
    grid.replaceChildren(space.grid
      ? bentGrid(space, scores, { contours, label: `Thin-plate grid ${called}, ${words}` })
      : h("p.muted.small", "All points lie on one line, so that there is no grid."));
    const tested = ({ groups: who, p, share, distance, specimens }) => h("li",
      `${who}: ${distance === null ? "" : `${numberText(distance)} apart, `}${(100 * share).toFixed(0)} % of the variance of shape of ${specimens}, P = ${p.toFixed(3)}`);
    tests.hidden = !data.tests.length;
    tests.replaceChildren(...data.tests.map(tested));
  }

  return { element, draw };
}
