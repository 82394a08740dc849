// Marks that a picture opens with: its own, the model's proposal, or the mean of the done pictures.

import { layoutIn, meanLayout } from "./points.js";

const LAYOUT_OF = 8; // number of done pictures in the mean layout

export class FirstMarks {
  /** fetchMarks(name) -> Promise of the server's marks; begins() -> "layout" or "click". */
  constructor({ state, fetchMarks, begins }) {
    Object.assign(this, { state, fetchMarks, begins });
    this.shapes = new Map(); // name -> {points, width, height} of done pictures
  }

  get template() {
    return this.state.project.template;
  }

  /** The landmarks of a picture have changed. */
  forget(name) {
    this.shapes.delete(name);
  }

  clear() {
    this.shapes.clear();
  }

  /** {points, invisible, source} for a picture, from the server's marks. */
  async of(name, marks) {
    const fits = marks.points.length === this.template.names.length; // a file may belong to another template
    if (fits && (marks.source === "file" || marks.source === "proposal")) {
      return { points: marks.points, invisible: marks.invisible ?? [], source: marks.source };
    }
    const nothing = { points: this.template.names.map(() => null), invisible: [], source: "none" };
    if (this.begins() === "click") return nothing;
    const points = await this.layout(name, marks.width, marks.height);
    return points ? { points, invisible: [], source: "layout" } : nothing;
  }

  /** Mean of the done pictures, or else the template's layout; null if there is neither. */
  async layout(name, width, height) {
    const done = this.state.project.pictures
      .filter((picture) => picture.state === "done" && picture.name !== name)
      .slice(0, LAYOUT_OF);
    await Promise.all(done.map((picture) => this.learn(picture.name)));
    const shapes = done.map((picture) => this.shapes.get(picture.name)).filter(Boolean);
    const whole = shapes.filter((shape) => shape.points.length === this.template.names.length);
    return meanLayout(whole, width, height) ?? layoutIn(this.template.points, width, height);
  }

  async learn(name) {
    if (this.shapes.has(name)) return;
    const marks = await this.fetchMarks(name).catch(() => null); // a failed picture is left out of the mean
    if (marks?.source === "file") this.shapes.set(name, marks);
  }
}
