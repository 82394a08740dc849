// The picture of the Live tab with its fit, the controls, and the timeline.

import { Divider } from "./divider.js";
import { drawFit, drawOver, entries, modelNeeded, Overlays } from "./fit-draw.js";
import { LiveGraphs } from "./live-graphs.js";
import { button, fileField, FrameMeter, h, icon, perFrame, press, relist, slider } from "./ui.js";
import { Viewer } from "./viewer.js";

const LATELY = 50; // frames over which the speed and the delay are averaged
const mirroredIn = ({ left, scale, width }) => 2 * left + scale * width; // where 0 lies in a mirrored picture
const LONGEST_GAP = 3000; // milliseconds; after a longer gap, as of a hidden page, the speed is measured anew

export class LiveView {
  #shown = null;
  #mirrored = false;
  #delays = [];
  #meter = new FrameMeter(LATELY, LONGEST_GAP);
  #divider;
  #overlays;
  #film = null; // canvas that is recorded, and its stream
  #filmed = null;
  // Elements.
  #bar; #cameras; #empty; #facts; #needs; #openers; #panels; #play; #slider; #status; #strip; #time; #tools;

  /** act: functions camera (by id), file (of a File), stop, play, flat, mirror, record, save and seek (to seconds).
   *  @param {HTMLElement} root; @param {App} app; @param {any} act */
  constructor(root, app, act) {
    const container = h("div.fit-viewer");
    this.viewer = new Viewer(container, { label: "Live picture" });
    this.viewer.addLayer((ctx, viewer) => this.#draw(ctx, viewer));
    this.#divider = new Divider(this.viewer, () => this.viewer.redraw(), "live-divider");
    this.#divider.label("Picture", "Without shading");
    const file = fileField(act.file, { accept: "video/*", "aria-label": "Open a video", testid: "live-file" });
    const tool = (label, name, more) =>
      button(label, { small: true, testid: `live-${name}`, title: label, onclick: act[name], ...more });
    this.#tools = {
      flat: tool("Remove shading", "flat", { pressed: false, shortcut: "F" }),
      mirror: tool("Mirror", "mirror", {
        icon: "mirror", pressed: false, shortcut: "X", title: "Show the camera as in a mirror; the track is not mirrored",
      }),
      record: tool("Record", "record", { icon: "target", pressed: false, shortcut: "R" }),
      save: tool("Export track", "save", { icon: "download" }), stop: tool("Stop", "stop", { icon: "close" }),
    };
    this.#cameras = h("select.text", {
      "aria-label": "Camera", testid: "live-cameras", onchange: () => act.camera(this.#cameras.value),
    });
    this.#play = tool("Play", "play", { shortcut: "P" });
    this.#openers = [
      button("Use the camera", { icon: "eye", kind: "primary", testid: "live-camera", onclick: () => act.camera() }),
      button("Open a video…", { icon: "upload", testid: "live-open", onclick: () => file.click() }),
    ];
    this.#strip = h("canvas.live-strip", { height: 8, "aria-hidden": "true" });
    this.#slider = slider({
      min: "0", step: "0.04", "aria-label": "Time in the video", testid: "live-time",
      oninput: perFrame(() => act.seek(Number(this.#slider.value))),
    });
    this.#time = h("span.number");
    const line = h("div.live-time", this.#strip, this.#slider);
    this.#bar = h("div.fit-bar.live-bar", this.#play, line, this.#time);
    this.#empty = h("div.empty.big.fit-empty", icon("play", 56), h("h2", "Follow the object in a video"),
      h("p", "Use your camera, or open a video or drop one here. It stays on this machine, and no frame is kept."),
      h("div.row", this.#openers));
    this.#overlays = new Overlays(["contours", "landmarks", "ellipses"], () => this.viewer.redraw(), "live");
    this.#status = h("p.fit-status", { role: "status", testid: "live-status" });
    this.#facts = h("dl.fit-facts");
    this.#needs = h("section.panel.column", modelNeeded(app));
    this.graphs = new LiveGraphs(app, act.seek);
    this.#panels = [
      h("section.panel.column", { "aria-label": "Result" }, this.#status, this.#facts),
      h("section.panel", { "aria-label": "Drawn over the picture" },
        h("div.row.tight.fit-overlays", this.#overlays.buttons)),
      this.graphs.element,
    ];
    const { flat, mirror, record, save, stop } = this.#tools;
    const tools = h("div.toolbar.live-toolbar", { role: "toolbar", "aria-label": "Video" },
      flat, mirror, this.#cameras, h("span.grow"), record, save, stop);
    root.append(h("div.fit-tab",
      h("div.workspace", tools, h("div.fit-stage", container, this.#empty), this.#bar),
      h("div.side.fit-side", this.#needs, this.#panels), file));
  }

  /** The frame that is shown, as given to `show`, or null. */
  get shown() { return this.#shown; }
  get mirrored() { return this.#mirrored; }
  /** Milliseconds from each of the last frames to its painted fit. */
  get delays() { return this.#delays; }
  get meter() { return this.#meter; }

  /** Show the picture as in a mirror, or as it is. */
  mirror(on) { this.#mirrored = on; }

  /** Show whether "flat" or "record" is on. */
  press(tool, on) { press(this.#tools[tool], on); }

  /** Show a frame with its fit: {time, canvas, flat, fit, grabbed}; or nothing (null). */
  show(frame) {
    this.#shown?.flat?.close();
    this.#shown = frame && { ...frame, isNew: true };
    if (frame && this.#film) this.#expose();
    this.#divider.show(Boolean(frame?.flat));
    this.viewer.redraw();
  }

  /** Film the frames as they are shown from now on, in the video's own size; returns the stream. */
  film({ videoWidth: width, videoHeight: height }) {
    this.#film = h("canvas", { width, height });
    return (this.#filmed = this.#film.captureStream(0)); // a frame at a time
  }

  #expose() {
    const [{ width, height }, ctx] = [this.#film, this.#film.getContext("2d")];
    const plane = { left: 0, top: 0, scale: 1, width, height, toScreen: ([x, y]) => [x + 0.5, y + 0.5] };
    this.#mirror(ctx, plane); // back, since the recording is not mirrored, like the track
    this.#paint(ctx, plane, (this.#divider.x - this.viewer.left) / this.viewer.scale);
    this.#filmed.getVideoTracks()[0].requestFrame();
  }

  key(event) {
    const chosen = { P: this.#play, F: this.#tools.flat, X: this.#tools.mirror, R: this.#tools.record }[event.key.toUpperCase()];
    chosen?.click();
    return Boolean(chosen) || this.#overlays.key(event) || this.viewer.key(event);
  }

  #draw(ctx, viewer) {
    if (!this.#shown) return;
    const { isNew, grabbed } = this.#shown;
    this.#paint(ctx, viewer, this.#divider.x);
    if (!isNew) return;
    this.#shown.isNew = false;
    this.#meter.tick();
    this.#delays = [...this.#delays.slice(1 - LATELY), performance.now() - grabbed];
  }

  /** Draw the frame with its fit, mirrored if wanted, and to the right of `from` without its shading. */
  #paint(ctx, plane, from) {
    const { canvas, flat, fit } = this.#shown;
    const [under, over] = flat && this.#mirrored ? [flat, canvas] : [canvas, flat];
    this.#mirror(ctx, plane);
    drawOver(ctx, plane, under);
    if (over) drawOver(ctx, plane, over, { from: this.#mirrored ? mirroredIn(plane) - from : from });
    if (fit.ok) drawFit(ctx, plane, fit, this.#overlays.shown);
  }

  /** If the picture is mirrored, mirror what is drawn next about its middle; twice: no longer. */
  #mirror(ctx, plane) {
    if (this.#mirrored) ctx.transform(-1, 0, 0, 1, mirroredIn(plane), 0);
  }

  /** @param {any} source; @param {Model | null} model */
  dress({ video, isOpen, isFile, camera, cameras }, model) {
    this.#needs.hidden = Boolean(model);
    for (const panel of this.#panels) panel.hidden = !model;
    this.#empty.hidden = isOpen;
    this.viewer.container.classList.toggle("without", !isOpen);
    for (const each of this.#openers) each.disabled = !model;
    for (const each of Object.values(this.#tools)) each.disabled = !isOpen;
    press(this.#tools.mirror, this.#mirrored);
    this.viewer.redraw();
    this.#tools.mirror.hidden = this.#tools.mirror.disabled = !isOpen || isFile;
    this.#cameras.hidden = this.#tools.mirror.hidden || Object.keys(cameras).length < 2;
    relist(this.#cameras, cameras, camera);
    this.graphs.offer(model);
    this.graphs.show(Boolean(model) && isOpen);
    this.#bar.hidden = this.#play.disabled = !isFile;
    this.#play.textContent = video.paused ? "Play" : "Pause";
    this.#overlays.allowContours(Boolean(model?.contours.length));
  }

  /** Show figures, and a message: {kind: "bad", "warn", "good" or "", text}. */
  tell({ kind, text }, track, isFile) {
    this.#status.textContent = text;
    this.#status.className = `fit-status ${{ bad: "error-text", warn: "warn-text" }[kind] ?? ""}`;
    const delay = [...this.#delays].sort((a, b) => a - b)[this.#delays.length >> 1] ?? 0;
    const rows = [
      ["Speed", `${this.#meter.rate().toFixed(0)} frames/s`], ["Delay", `${delay.toFixed(0)} ms`],
      ["Frames", `${track.rows.size}, ${track.lost} lost${isFile ? `, ${track.skipped} skipped` : ""}`],
      ["Centre", this.#shown?.fit.ok ? this.#shown.fit.centre.map((v) => v.toFixed(0)).join(", ") : "–"],
    ];
    this.#facts.replaceChildren(...(this.#shown ? entries(rows) : []));
  }

  /** Draw the timeline: green, amber or red where frames are tracked. It has no width while the tab is hidden. */
  drawTime({ currentTime, duration }, track) {
    if (!duration || !this.#strip.clientWidth) return;
    Object.assign(this.#slider, { max: String(duration), value: String(currentTime) });
    this.#time.textContent = `${currentTime.toFixed(1)} / ${duration.toFixed(1)} s`;
    const width = (this.#strip.width = this.#strip.clientWidth);
    const [ctx, style] = [this.#strip.getContext("2d"), getComputedStyle(this.#strip)];
    for (const [time, kind] of track.marks()) {
      ctx.fillStyle = style.getPropertyValue(`--${kind}`);
      ctx.fillRect(Math.floor((time / duration) * width), 0, Math.ceil(width / (25 * duration)), 8);
    }
  }
}
