// Graphs over time beside the picture of the Live tab: a distance of two points, the pose, and the quality.

import { distanceOf, firstPair } from "./live-track.js";
import { attempt } from "./unsaved.js";
import { h, optionsOf } from "./ui.js";

const LIBRARY = "../vendor/uplot/uPlot.esm.js"; // uPlot: https://github.com/leeoniya/uPlot
const LATELY = 30; // seconds of a camera that are shown
const HEIGHT = 64; // css pixels
const KEY = "liaam-studio:live-distance"; // the pair of points that was chosen last
const NOTE = "Roll is the turn in the picture from the model's mean shape. Turns to the side and nods are not measured.";
const MOUTH = ["upper_lip_bottom", "lower_lip_top"]; // its opening, in the model of faces that comes with liaam

export class LiveGraphs {
  /** seek(time): a click on a graph of a video. @param {App} app */
  constructor(app, seek) {
    this.app = app;
    this.seek = seek;
    const select = (label, testid) =>
      h("select.text", { "aria-label": label, testid, onchange: () => this._choose() });
    this._ends = [select("From point", "live-from"), select("To point", "live-to")];
    this._graphs = [
      { name: "Distance", unit: " px", of: (frame) => distanceOf(this.pair)(frame), more: this._ends },
      { name: "Roll", unit: "°", of: ({ roll }) => roll },
      { name: "Size", unit: " px", of: ({ size }) => size },
      { name: "Quality", unit: " %", of: ({ quality }) => (quality === null ? null : 100 * quality) },
    ].map((graph) => ({ ...graph, chart: null, value: h("span.number"), plot: h("div.live-graph", { role: "img" }) }));
    this.element = h("section.panel.live-graphs", { "aria-label": "Over time" }, this._graphs.map(({ name, value, plot, more }) =>
      [h("div.row.tight.small", h("span.grow", name), value), more && h("div.row.tight", more), plot]),
      h("p.small.muted", NOTE));
  }

  /** The model has changed: its points can be chosen. */
  offer(/** @type {Model | null} */ model) {
    if (!model || model.number === this._model) return;
    this._model = model.number;
    const names = Array.from({ length: model.n_points }, (_, i) => model.names[i] ?? `point ${i + 1}`);
    const measured = attempt(() => JSON.parse(localStorage.getItem(`liaam-studio:measures:${this.app.state.project.id}`))[0], "");
    const pairs = [attempt(() => JSON.parse(localStorage.getItem(KEY)), null), /distance:(.+?)-(\S+)/.exec(measured)?.slice(1), MOUTH];
    const options = Object.fromEntries(names.map((name, i) => [i, name]));
    this.pair = firstPair(names, pairs.filter(Boolean));
    this._ends.forEach((select, end) => {
      select.replaceChildren(...optionsOf(options));
      select.value = String(this.pair[end]);
    });
  }

  _choose() {
    this.pair = this._ends.map(({ value }) => Number(value));
    localStorage.setItem(KEY, JSON.stringify(this._ends.map(({ selectedOptions: [option] }) => option.textContent)));
  }

  /** Draw the track of a source. It has no width while the tab is hidden. */
  async draw({ video, isFile }, track) {
    const width = this._graphs[0].plot.clientWidth;
    if (!width || !this.pair || !track.rows.size) return;
    const { default: Plot } = await import(LIBRARY);
    const now = isFile ? video.currentTime : track.end;
    this._range = isFile ? [0, video.duration || 1] : [now - LATELY, now];
    this._cursor = isFile ? now : null;
    const [times, ...all] = track.graphs(this._graphs.map(({ of }) => of), this._range[0]);
    const at = times.findLastIndex((time) => time <= now + 1e-3);
    this._graphs.forEach((graph, i) => {
      graph.chart ??= new Plot(this._options(graph, i, width), [[], []], graph.plot);
      if (graph.chart.width !== width) graph.chart.setSize({ width, height: graph.chart.height });
      graph.chart.setData([times, all[i]]);
      const number = all[i][graph.chart.cursor.idx ?? at]; // under the pointer, or now
      graph.value.textContent = number == null ? "–" : `${number.toFixed(1)}${graph.unit}`;
      graph.plot.setAttribute("aria-label", `${graph.name} over time: ${graph.value.textContent}`);
    });
  }

  _options({ unit }, i, width) {
    const style = getComputedStyle(this.element);
    const colour = (name) => () => style.getPropertyValue(`--${name}`);
    const isLast = i === this._graphs.length - 1;
    const axis = { stroke: colour("muted"), font: "11px system-ui, sans-serif", ticks: { show: false } };
    const line = { stroke: colour("line"), width: 1 };
    const seconds = (_, ticks) => ticks.map((tick) => `${this._cursor === null ? Math.round(tick - this._range[1]) : tick} s`);
    return {
      width, height: HEIGHT + (isLast ? 20 : 0), legend: { show: false }, padding: [6, 4, 4, 0],
      scales: { x: { time: false, range: () => this._range }, y: { range: (_, low, high) => widened(low, high) } },
      axes: [
        { ...axis, grid: line, size: isLast ? 20 : 0, gap: 2, values: isLast ? seconds : () => [], space: 60 },
        { ...axis, grid: line, size: 40, gap: 2, space: 22 },
      ],
      series: [{}, { stroke: colour("accent"), width: 1.5, points: { show: false } }],
      cursor: { sync: { key: "liaam" }, y: false, drag: { x: false, y: false }, points: { size: 6 } },
      hooks: {
        init: [({ over, posToVal, cursor }) => over.addEventListener("click", () => this._cursor !== null && this.seek(posToVal(cursor.left, "x")))],
        draw: [(chart) => this._drawCursor(chart, colour("text")())],
      },
    };
  }

  /** Draw a line at the time that a video shows. */
  _drawCursor({ ctx, bbox: { top, height }, valToPos }, colour) {
    if (this._cursor === null) return;
    ctx.fillStyle = colour;
    ctx.fillRect(Math.round(valToPos(this._cursor, "x", true)), top, devicePixelRatio, height);
  }
}

/** A range with some room, so that noise does not fill a graph. */
function widened(low, high) {
  const [middle, half] = [(low + high) / 2, Math.max((high - low) / 2, 1)];
  return low === null ? [0, 1] : [middle - 1.1 * half, middle + 1.1 * half];
}
