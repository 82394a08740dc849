// Marks that a picture opens with: its own, the model's proposal, or the mean of the done pictures.

import { layoutIn, meanLayout } from "./points.js";

const LAYOUT_OF = 8; // number of done pictures in the mean layout

export class FirstMarks {
  /** fetchMarks(name) -> Promise of the server's marks; begins() -> "layout" or "click". */
  constructor({ state, fetchMarks, begins }) {
    this.state = state;
    this.fetchMarks = fetchMarks;
    this.begins = begins;
    this.shapes = new Map(); // name -> promise of the marks of a done picture
  }

  /** The landmarks of a picture, or of all, have changed. */
  forget(name = null) {
    if (name === null) this.shapes.clear();
    else this.shapes.delete(name);
  }

  /** {points, invisible, source, bar} for a picture, from the server's marks. */
  async of(name, { points, invisible, source, width, height, bar = null }) {
    const { names } = this.state.project.template;
    const fits = points.length === names.length; // a file may belong to another template
    if (fits && (source === "file" || source === "proposal")) return { points, invisible: invisible ?? [], source, bar };
    const layout = this.begins() === "click" ? null : await this.layout(name, width, height);
    const own = layout ? { points: layout, source: "layout" } : { points: names.map(() => null), source: "none" };
    return { ...own, invisible: [], bar };
  }

  /** Mean of the done pictures, or else the template's layout; null if there is neither. */
  async layout(name, width, height) {
    const { template, pictures } = this.state.project;
    const done = pictures.filter((picture) => picture.state === "done" && picture.name !== name).slice(0, LAYOUT_OF);
    const shapes = await Promise.all(done.map((picture) => this.learn(picture.name)));
    const whole = shapes.filter((shape) => shape?.source === "file" && shape.points.length === template.names.length);
    return meanLayout(whole, width, height) ?? layoutIn(template.points, width, height);
  }

  /** Marks of a done picture; null if they cannot be fetched, so that it is left out of the mean. */
  learn(name) {
    const fetched = () => this.fetchMarks(name).catch(() => { this.shapes.delete(name); return null; });
    if (!this.shapes.has(name)) this.shapes.set(name, fetched());
    return this.shapes.get(name);
  }
}
