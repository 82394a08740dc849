// The measures of the Measure tab, drawn over the picture that is annotated, with their values.

import { COLOURS, drawText } from "./drawing.js";
import { kindFor, measureOf, measureText, numberText, parsed, valueOf } from "./measures.js";
import { inked, lines } from "./overlays.js";
import { distance, mean } from "./points.js";

/** @param {import("./annotate.js").Tab} tab */
export function createMeasured(tab) {
  const { state, marking, viewer, ruler } = tab;
  let measures = [];
  const read = () => {
    const { measuring, template } = state.project;
    measures = measuring.measures.map((each) => parsed(each, template?.names ?? [])).filter(Boolean);
    viewer.redraw();
  };
  for (const event of ["measuring", "project"]) state.addEventListener(event, read);
  read();

  const pixel = () => ruler.bar && { length: ruler.bar.length / distance(...ruler.bar.ends), unit: ruler.bar.unit };

  function drawOne(ctx, measure) {
    const found = valueOf(measure, marking.points, pixel());
    if (!found) return;
    const places = measure.indices.map((i) => viewer.toScreen(marking.points[i]));
    lines(ctx, [measure.kind === "area" ? [...places, places[0]] : places]);
    inked(ctx, COLOURS.axis, 1.6, [6, 3]);
    const [x, y] = measure.kind === "angle" ? places[1] : [0, 1].map((side) => mean(places.map((place) => place[side])));
    drawText(ctx, numberText(found.value, found.unit), x, y - 8, { align: "center" });
  }

  return {
    draw(ctx) {
      if (tab.shown.drawn.measures && !viewer.isLoupe) for (const each of measures) drawOne(ctx, each);
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
