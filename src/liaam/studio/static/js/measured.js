// The measures of the Measure tab, drawn over the picture that is annotated, with their values.

import { COLOURS, drawText } from "./drawing.js";
import { joined, keepWanted, kindFor, measured, measureOf, measuresIn, measureText, numberText, parsed, valueOf, wantedIn } from "./measures.js";
import { inked, lines } from "./overlays.js";
import { distance, mean } from "./points.js";

/** @param {import("./annotate.js").Tab} tab */
export function createMeasured(tab) {
  const { state, marking, viewer, ruler } = tab;
  let measures = [];
  const read = () => {
    const { names } = state.project.template ?? { names: [] };
    measures = measuresIn(wantedIn(state.project.id).measures).map((each) => parsed(each, names)).filter(Boolean);
    viewer.redraw();
  };
  for (const [target, event] of /** @type {[EventTarget, string][]} */ ([[measured, "change"], [state, "project"]])) target.addEventListener(event, read);
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
    add(indices) {
      const { id, template } = state.project;
      const measure = measureOf(kindFor(indices.length), indices);
      const wanted = wantedIn(id);
      tab.shown.draw("measures");
      keepWanted(id, { ...wanted, measures: joined([...measuresIn(wanted.measures), measure]) });
      return measureText(measure, template.names);
    },
  };
}
