// The first screen, of an empty folder: a photograph of a face under a lamp that follows the pointer, and ways to begin.

import { fileOf } from "./api.js";
import { directionAt, lampHandle, pixelsOf } from "./relight.js";
import { perFrame, button, h, icon } from "./ui.js";

const AMBIENT = [0.05, 0.065, 0.09]; // linear red, green and blue of the light from everywhere
const LAMP = [1.2, 1.07, 0.88];
const MOST = 1.6; // most light, relative to the photograph without its shading
const NEAR = 0.16; // distance over a ball of radius 1 of lamps whose light is mixed
const FIRST = [-0.82, -0.3]; // where the lamp is at first
const PHASES = { hard: 500, wipe: 1900, flat: 2600, end: 16000 }; // milliseconds: the wipe, then the lamp goes round
const MIDDLE = [0.5, 0.47]; // of the face, as fractions of the picture
const GAMMA = Uint8ClampedArray.from({ length: 2048 }, (_, i) => 255 * (i / 2047) ** (1 / 2.2));

/** Light of lamps as a sum of layers, which making/first_screen.py has prepared. */
export class Layers {
  #n; // layers
  #size; // pixels
  #lamps;
  #coefficients;
  #values;

  /** pixels: RGBA of all layers, one below the other; the first is ambient light. */
  constructor(pixels, { low, high, lamps, coefficients }) {
    const [n, size] = [low.length, pixels.length / 4 / low.length];
    this.#n = n;
    this.#size = size;
    this.#lamps = lamps;
    this.#coefficients = coefficients;
    const value = (i, k) => low[k] + ((high[k] - low[k]) * pixels[4 * (k * size + i)]) / 255;
    this.#values = Float32Array.from({ length: n * size }, (_, j) => value(Math.floor(j / n), j % n));
  }

  /** Coefficients of a lamp at [x, y] over the ball: those of nearby lamps, mixed. */
  #mixed([x, y]) {
    const near = this.#lamps.map(([u, v]) => Math.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * NEAR ** 2)));
    const total = near.reduce((sum, each) => sum + each, 1e-9);
    return this.#coefficients[0].map((_, k) =>
      near.reduce((sum, each, j) => sum + each * this.#coefficients[j][k], 0) / total);
  }

  draw(at, target) {
    const [values, n, size] = [this.#values, this.#n, this.#size];
    const weights = Float32Array.from([0, ...this.#mixed(at)]);
    const [here, lamp] = [AMBIENT, LAMP].map((colour) => colour.map((each) => (each * 2047) / MOST));
    for (let i = 0, j = 0; i < size; i += 1, j += n) {
      let lit = 0;
      for (let k = 1; k < n; k += 1) lit += weights[k] * values[j + k];
      if (lit < 0) lit = 0;
      for (let c = 0; c < 3; c += 1)
        target[4 * i + c] = GAMMA[Math.min(here[c] * values[j] + lamp[c] * lit, 2047) | 0];
    }
  }
}

const load = async (name) => createImageBitmap(await (await fetch(fileOf(`first/${name}`))).blob());

/** The picture with its lamp. */
class RelitFace {
  #at = FIRST;
  #flat = 0; // fraction that is shown without shading, from the left
  #frames = 0;
  #isMoved = false; // by a person
  #lamp;
  #face; // the photograph, and the same as bright as it becomes
  #bright;
  #layers;
  #image; // the light, and a canvas with it
  #small;

  constructor() {
    this.canvas = h("canvas.first-face", { width: 640, height: 640, "aria-hidden": "true" });
    this.#lamp = lampHandle({
      class: "first-lamp", "aria-label": "Lamp", testid: "first-lamp", middle: MIDDLE, onmove: (to) => this.#move(to),
    });
    const follow = perFrame((event) => this.#move(this.#lamp.at(event)));
    this.element = h("div.first-picture", { testid: "first-picture", onpointermove: follow, onpointerdown: follow },
      this.canvas, this.#lamp.element);
    this.#load();
  }

  /** How often the picture was painted, and whether a person has moved the lamp: for tests and benchmarks. */
  get frames() { return this.#frames; }
  get moved() { return this.#isMoved; }

  async #load() {
    const [face, light, facts] = await Promise.all([
      load("face.jpg"), load("light.jpg"), fetch(fileOf("first/light.json")).then((answer) => answer.json())]);
    this.#face = face;
    const { width } = light;
    this.#layers = new Layers(pixelsOf(light).data, facts);
    this.#bright = new OffscreenCanvas(face.width, face.height);
    const bright = this.#bright.getContext("2d");
    bright.filter = `brightness(${MOST ** (1 / 2.2)})`;
    bright.drawImage(face, 0, 0);
    this.#small = new OffscreenCanvas(width, width);
    this.#image = new ImageData(width, width);
    this.#image.data.fill(255);
    this.#isMoved = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.#flat = this.#isMoved ? 0.5 : 0;
    this.#draw();
    if (!this.#isMoved) this.#play(performance.now());
  }

  /** Wipe from hard light to none, then lead the lamp round the face, until a person moves it. */
  #play(began) {
    const step = (now) => {
      if (this.#isMoved || !this.element.isConnected) return;
      const t = now - began;
      const angle = Math.PI + Math.max(0, t - PHASES.flat) / 1600;
      const wiped = Math.min(Math.max((t - PHASES.hard) / (PHASES.wipe - PHASES.hard), 0), 1);
      this.#flat = t < PHASES.flat ? wiped * wiped * (3 - 2 * wiped) : 0;
      if (t > PHASES.flat) this.#at = [0.85 * Math.cos(angle), 0.6 * Math.sin(angle) - 0.1];
      if (this.canvas.checkVisibility()) this.#draw();
      if (t < PHASES.end) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  #move(/** @type {number[]} */ [x, y]) {
    this.#at = [x, y];
    this.#isMoved = true;
    this.#flat = 0;
    if (this.#layers) this.#draw();
  }

  #draw() {
    const [canvas, flat] = [this.canvas, this.#flat];
    const { width, height } = canvas;
    const ctx = canvas.getContext("2d");
    this.#layers.draw(this.#at, this.#image.data);
    this.#small.getContext("2d").putImageData(this.#image, 0, 0);
    ctx.globalCompositeOperation = "copy";
    ctx.drawImage(this.#bright, 0, 0);
    ctx.globalCompositeOperation = "multiply";
    ctx.drawImage(this.#small, 0, 0, width, height);
    ctx.globalCompositeOperation = "source-over";
    if (flat > 0) ctx.drawImage(this.#face, 0, 0, flat * width, height, 0, 0, flat * width, height);
    if (flat > 0 && flat < 1) {
      ctx.fillStyle = "rgb(255 255 255 / 85%)";
      ctx.fillRect(flat * width - 1, 0, 2, height);
    }
    this.#lamp.show(directionAt(this.#at));
    this.#lamp.fade(1 - flat);
    this.#frames += 1;
  }
}

/** @param {App} app */
export function createFirstScreen(app) {
  const face = new RelitFace();
  const fit = async () => {
    const file = new File([await (await fetch(fileOf("first/face.jpg"))).blob()], "face.jpg", { type: "image/jpeg" });
    app.openTab("fit", { view: "relit" });
    await app.sources.take(file);
  };
  const drop = h("button.first-drop", { type: "button", testid: "add-first", onclick: () => app.adding.choose() },
    icon("upload", 22), h("span", "Drop pictures or landmark files here"));
  const camera = button("Camera", { icon: "eye", testid: "first-camera", onclick: () => app.openTab("live", { camera: true }) });
  const fitting = button("Fit this face", { icon: "target", testid: "first-fit", onclick: fit });
  const show = () => { camera.disabled = fitting.disabled = !app.state.project.model; };
  app.state.addEventListener("project", show);
  show();
  window.liaamStudio.first = face;
  return h("div.first", { testid: "first" }, face.element, h("div.first-words",
    h("h2", "Landmarks on your own pictures, placed and measured"),
    h("p", "Drop your pictures and click the points on a few of them: a model places the rest, and you check and measure " +
      "them all. Or drop one portrait, and move its light."),
    h("div.row.first-ways", drop, camera, fitting),
    h("p.small.muted", "Everything stays on this machine. Photograph: Lisa DeBruine, CC0.")));
}
