// The measures of the Measure tab, drawn over the picture that is annotated, with their values.

import { drawText, widthOf } from "./drawing.js";
import { kindFor, measureOf, measureText, numberText, parsed, valueOf } from "./measures.js";
import { inked, lines } from "./overlays.js";
import { distance, mean } from "./points.js";

// Colours of measures, which differ from each other and from those of points: a measure and its value have the same.
const HUES = ["#ffb3f0", "#8ce0ff", "#ffe08a", "#b6f2a0", "#ffb38a", "#c9b8ff"];
const LINE = 15; // css pixels down that a value takes
const APART = 8; // css pixels between values

/** @param {import("./annotate.js").Tab} tab */
export function createMeasured(tab) {
  const { state, marking, viewer, ruler } = tab;
  let measures = [];
  const readAll = () => {
    const { measuring, template } = state.project;
    const read = (text) => {
      const measure = parsed(text, template?.names ?? []);
      return measure && { ...measure, name: measuring.names[text] };
    };
    measures = measuring.measures.map(read).filter(Boolean);
    viewer.redraw();
  };
  for (const event of ["measuring", "project"]) state.addEventListener(event, readAll);
  readAll();

  const pixel = () => (ruler.bar ? { length: ruler.bar.length / distance(...ruler.bar.ends), unit: ruler.bar.unit }
    : marking.book?.pixel ?? null);

  /** Place of a text of a width where no earlier one is: of each, its middle and its width. */
  function freeOf([x, y], wide, taken) {
    const isTaken = ([u, v, other]) => Math.abs(u - x) < (wide + other) / 2 + APART && Math.abs(v - y) < LINE;
    for (let tries = 0; tries <= measures.length && taken.some(isTaken); tries += 1) y += LINE;
    taken.push([x, y, wide]);
    return [x, y];
  }

  function drawOne(ctx, measure, colour, taken) {
    const found = valueOf(measure, marking.points, pixel());
    if (!found) return;
    const places = measure.indices.map((i) => viewer.toScreen(marking.points[i]));
    lines(ctx, [measure.kind === "area" ? [...places, places[0]] : places]);
    inked(ctx, colour, 1.6, [6, 3]);
    const at = measure.kind === "angle" ? places[1] : [0, 1].map((side) => mean(places.map((place) => place[side])));
    const value = numberText(found.value, found.unit);
    const text = measure.name ? `${measure.name} ${value}` : value;
    const [x, y] = freeOf([at[0], at[1] - 8], widthOf(ctx, text), taken);
    drawText(ctx, text, x, y, { align: "center", colour });
  }

  return {
    draw(ctx) {
      if (!tab.shown.drawn.measures || viewer.isLoupe) return;
      const taken = ruler.label(ctx, viewer) ?? []; // places of texts
      measures.forEach((measure, i) => drawOne(ctx, measure, HUES[i % HUES.length], taken));
    },

    /** Measure points in all pictures, as many as there are: a distance, an angle or an area; return it in words. */
    async add(indices) {
      const measure = measureOf(kindFor(indices.length), indices);
      await state.changeMeasuring({ add: [measure] });
      tab.shown.draw("measures");
      return measureText(measure, state.project.template.names);
    },
  };
}
