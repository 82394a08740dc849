// The space of shapes: a scatter of principal components, the shapes over each other, and the thin-plate grid of a change.

import { numberText } from "./measures.js";
import { bentGrid, scatter, superimposed } from "./shape-plots.js";
import { button, h, labelledSlider, relist } from "./ui.js";

const MOST_NAMED = 12; // unusual shapes that are named
const MOST_AXES = 10; // components that can be chosen
const MOST_PAIRS = 30; // pairs of groups that can be chosen
const SELECTED = "selected";
const UNTESTED = "The groups are not tested: that takes two groups of two shapes or more, and at most 1000 pictures. “liaam measure --groups” has no such limit.";
const MOST_AMOUNT = 3; // standard deviations, or times a change, to which the slider goes

const percent = (share, digits = 0) => `${(100 * share).toFixed(digits)} %`;

// In the list of changes, a pair of groups is a text such as "0>2".
const pairText = (from, to) => `${from}>${to}`;
const pairIn = (text) => (text.includes(">") ? text.split(">").map(Number) : null);

/** Standard deviation of scores, whose mean is 0. */
const deviation = (scores) =>
  Math.sqrt(scores.reduce((sum, score) => sum + score * score, 0) / Math.max(1, scores.length - 1));

/** The Shapes view of a Measure tab: {element, draw(), show(on)}. @param {import("./measure.js").Tab} tab */
export function createShapeSpace(tab) {
  const axes = { across: 0, upward: 1 }; // components that the scatter shows
  let change = "0"; // what the grid shows: a component by its index, SELECTED, or a pair of groups (pairText)
  let amount = 1; // of that change
  let lastPicture = null; // the selected picture when it was drawn last

  const componentList = (which, label) => h("select.text", {
    "aria-label": label,
    testid: `shape-${which}`,
    onchange: (event) => {
      axes[which] = Number(event.target.value);
      draw();
    },
  });
  const across = componentList("across", "Component across");
  const upward = componentList("upward", "Component upward");
  const changeList = h("select.text", {
    "aria-label": "Change",
    testid: "shape-change",
    onchange: () => {
      change = changeList.value;
      amount = 1;
      draw();
    },
  });
  const slider = labelledSlider("Amount", (value) => { amount = value; draw(); }, {
    min: String(-MOST_AMOUNT),
    max: String(MOST_AMOUNT),
    step: "0.1",
    "aria-label": "Amount of the change",
    testid: "shape-amount",
    class: "row shape-amount",
  });
  const scatterPlot = h("div.measure-plot", { testid: "shape-scatter" });
  const cloudPlot = h("div.measure-plot", { testid: "shape-cloud" });
  const cloudTitle = h("h2.panel-title");
  const gridPlot = h("div.measure-plot", { testid: "shape-grid" });
  const outliers = h("div.row.tight.small", { testid: "shape-outliers" });
  const tests = h("ul.small.shape-tests", { testid: "shape-tests", "aria-label": "Differences between groups" });
  const whyNot = h("p.muted", { testid: "shape-why-not" });
  const sidesNote = h("p.muted.small", { testid: "shape-sides" });
  const cards = h("div.measure-cards.shape-cards",
    h("section.panel.measure-card.shape-main", { "aria-label": "Principal components" },
      h("div.row", h("h2.panel-title.grow", "Principal components"), across, "and", upward), sidesNote, scatterPlot, outliers, tests),
    h("section.panel.measure-card", { "aria-label": "Thin-plate grid" },
      h("div.row", h("h2.panel-title.grow", "Change as a grid"), changeList), slider.element, gridPlot),
    h("section.panel.measure-card", { "aria-label": "Procrustes superimposition" },
      cloudTitle, cloudPlot));
  const element = h("div.measure-view", whyNot, cards);

  /** The group of each shape as an index; -1 for none. */
  function groupsOf(/** @type {Space} */ space) {
    const { of } = tab.groups; // once, since it is computed
    return space.of.map((picture) => of[picture]);
  }

  /** Index of the selected picture among those that have a shape; -1 for none. */
  const selectedIn = (/** @type {Space} */ space) => space.of.indexOf(tab.chosen);

  /** Mean scores of a group. */
  function centreOf(/** @type {Space} */ space, group) {
    const groups = groupsOf(space);
    const rows = space.scores.filter((_, i) => groups[i] === group);
    return space.axes.map((_, c) => rows.reduce((sum, row) => sum + row[c], 0) / rows.length);
  }

  /** The change that the grid shows: its scores at amount 1, its name, and the unit of its amount. */
  function changeOf(/** @type {Space} */ space) {
    if (change === SELECTED) return changeToSelected(space);
    const pair = pairIn(change);
    return pair ? changeBetween(space, pair) : changeAlong(space, Number(change));
  }

  function changeToSelected(/** @type {Space} */ space) {
    const noChange = space.axes.map(() => 0);
    const scores = space.scores[selectedIn(space)] ?? noChange;
    return { scores, name: `from the mean shape to ${tab.state.current}`, unit: "times" };
  }

  function changeBetween(/** @type {Space} */ space, /** @type {number[]} */ [from, to]) {
    const start = centreOf(space, from);
    const end = centreOf(space, to);
    const scores = end.map((score, c) => score - start[c]);
    const { names } = tab.groups;
    return { scores, name: `from ${names[from]} to ${names[to]}`, unit: "times" };
  }

  function changeAlong(/** @type {Space} */ space, component) {
    const step = deviation(space.scores.map((row) => row[component]));
    const scores = space.axes.map((_, c) => (c === component ? step : 0));
    return { scores, name: `along PC${component + 1}`, unit: "SD" };
  }

  /** All pairs [a, b] of groups that have shapes, as indices. */
  function pairsOfGroups(/** @type {Space} */ space) {
    const groups = new Set(groupsOf(space));
    const present = tab.groups.names.map((_, i) => i).filter((i) => groups.has(i));
    return present.flatMap((a) => present.filter((b) => b > a).map((b) => [a, b]));
  }

  function fillLists(/** @type {Space} */ space) {
    const shares = space.shares.slice(0, MOST_AXES);
    const components = Object.fromEntries(shares.map((share, c) => [c, `PC${c + 1}, ${percent(share)}`]));
    axes.across = Math.min(axes.across, shares.length - 1);
    axes.upward = Math.min(axes.upward, shares.length - 1);
    relist(across, components, String(axes.across));
    relist(upward, components, String(axes.upward));

    const { names } = tab.groups;
    const pairs = pairsOfGroups(space).slice(0, MOST_PAIRS);
    // An object lists keys that are numbers first; these are first here, too.
    const changes = Object.fromEntries([
      ...shares.map((_, c) => [String(c), `Along PC${c + 1}`]),
      [SELECTED, "To the selected picture"],
      ...pairs.map(([a, b]) => [pairText(a, b), `${names[a]} to ${names[b]}`]),
    ]);
    if (!(change in changes)) change = "0"; // its group or component is no longer there
    relist(changeList, changes, change);
  }

  /** Indices of the shapes that are unusually far from the mean, the farthest first. */
  function unusualIn(/** @type {Space} */ { distances, limit }) {
    const far = distances.map((_, i) => i).filter((i) => distances[i] > limit);
    return far.sort((a, b) => distances[b] - distances[a]);
  }

  function drawOutliers(/** @type {Space} */ space, unusual) {
    if (!unusual.length) return outliers.replaceChildren(h("span.muted", "No shape is unusually far from the mean."));
    const limit = numberText(space.limit);
    const buttons = unusual.slice(0, MOST_NAMED).map((i) => button(tab.data.pictures[space.of[i]], {
      small: true,
      title: `${numberText(space.distances[i])} from the mean shape; unusual are those beyond ${limit}`,
      testid: "shape-outlier",
      onclick: () => tab.choose(space.of[i]),
    }));
    const more = unusual.length - buttons.length;
    return outliers.replaceChildren("Unusual shapes:", ...buttons, more > 0 ? `and ${more} more` : "");
  }

  function drawScatter(/** @type {Space} */ space, unusual) {
    const { across: x, upward: y } = axes;
    scatterPlot.replaceChildren(scatter({
      points: space.scores.map((row) => [row[x], row[y] ?? 0]), // there may be a single component
      groups: groupsOf(space),
      chosen: selectedIn(space),
      unusual: new Set(unusual),
      titles: [x, y].map((c) => `PC${c + 1} (${percent(space.shares[c], 1)})`),
      names: space.of.map((picture) => tab.data.pictures[picture]),
      onpick: (i) => tab.choose(space.of[i]),
      width: scatterPlot.clientWidth || undefined,
    }));
  }

  /** The contours between the landmarks that the shapes have. */
  function contoursIn(/** @type {Space} */ space) {
    const position = new Map(space.landmarks.map((landmark, i) => [landmark, i]));
    return tab.contours.map(({ indices, closed }) => {
      const present = indices.filter((landmark) => position.has(landmark));
      return { indices: present.map((landmark) => position.get(landmark)), closed };
    });
  }

  function drawCloud(/** @type {Space} */ space, contours) {
    const chosen = space.shapes[selectedIn(space)] ?? null;
    const [drawn, all] = [space.shapes.length, space.of.length];
    cloudTitle.textContent = drawn < all ? `The first ${drawn} of ${all} shapes, superimposed` : "All shapes, superimposed";
    cloudPlot.replaceChildren(
      superimposed({ shapes: space.shapes, mean: space.mean, contours, chosen, groups: groupsOf(space), width: cloudPlot.clientWidth || undefined }));
  }

  function drawGrid(/** @type {Space} */ space, contours) {
    const { scores, name, unit } = changeOf(space);
    const words = unit === "SD" ? `${amount.toFixed(1)} SD` : `× ${amount.toFixed(1)}`;
    slider.show(amount, words);
    gridPlot.replaceChildren(space.grid
      ? bentGrid(space, scores.map((score) => amount * score), {
        contours, label: `Thin-plate grid ${name}, ${words}`, width: gridPlot.clientWidth || undefined,
      })
      : h("p.muted.small", "All points lie on one line, so that there is no grid."));
  }

  function drawTests() {
    const line = (/** @type {GroupTest} */ { groups, p, share, distance, specimens }) => {
      const apart = distance === null ? "" : `${numberText(distance)} apart, `;
      return h("li", `${groups}: ${apart}${percent(share)} of the variance of shape of ${specimens}, P = ${p.toFixed(3)}`);
    };
    const isUntested = !tab.data.tests.length && tab.groups.names.length > 1;
    tests.hidden = !tab.data.tests.length && !isUntested;
    tests.replaceChildren(...(isUntested ? [h("li.muted", UNTESTED)] : tab.data.tests.map(line)));
  }

  function draw() {
    const { space, why_not: reason, sides } = tab.data;
    whyNot.hidden = Boolean(space);
    cards.hidden = !space;
    whyNot.textContent = space ? "" : `Shapes are compared from three complete pictures on: ${reason}.`;
    const isWhole = !space || space.of.length === tab.data.pictures.length;
    sidesNote.hidden = !sides && isWhole;
    sidesNote.textContent = [
      sides && `${sides[0].toUpperCase()}${sides.slice(1)}.`, !isWhole && "“Estimate missing points” includes pictures that lack points.",
    ].filter(Boolean).join(" ");
    if (!space) return;
    if (lastPicture !== tab.state.current && change === SELECTED) amount = 1; // another picture is another change
    lastPicture = tab.state.current;
    fillLists(space);
    const unusual = unusualIn(space);
    const contours = contoursIn(space);
    drawOutliers(space, unusual);
    drawScatter(space, unusual);
    drawCloud(space, contours);
    drawGrid(space, contours);
    drawTests();
  }

  const show = (on) => { element.hidden = !on; };
  return { element, draw, show };
}
