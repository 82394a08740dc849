// The Live tab: follow the object in the picture of a camera, or in a video.

import { several } from "./annotate-words.js";
import { api } from "./api.js";
import { objectOf } from "./fit-run.js";
import { LiveSource } from "./live-source.js";
import { isJump, sentSize, Track, verdictOfFrame } from "./live-track.js";
import { LiveView } from "./live-view.js";
import { isPlain, saveFile } from "./ui.js";

const AT_ONCE = 3; // frames that the server works on
const GRAPHS = 125; // milliseconds between two drawings of the graphs

export class Tab {
  #isFlat = false; // whether the shading is removed
  #recorded = new Blob();
  shortcuts = [
    { keys: "P", what: "Play, pause" },
    { keys: "F", what: "Remove the shading" },
    { keys: "X", what: "Show the camera as in a mirror" },
    { keys: "R", what: "Record" },
    { keys: "C L M E", what: "Show contours, points, mesh, ellipses" },
  ];
  /** @type {App} */
  #app;
  #source;
  #view;
  #track;
  #message = ""; // what is wrong
  #recorder = null;
  /** @type {Promise<LiveVideo> | null} */
  #video = null; // the server's work on the video
  #number = 0; // of the next frame
  #inFlight = 0; // frames that the server works on
  #before = null; // time of the frame that was sent last
  #missed = null; // time of the newest frame that waits, or null

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.#app = app;
    this.#source = new LiveSource((time) => this.#frame(time));
    this.#view = new LiveView(root, app, {
      camera: (id) => this.#start(() => this.#source.openCamera(id)), file: (file) => this.show({ file }),
      stop: () => this.#stop(), play: () => this.#source.toggle(),
      record: () => this.#record(), mirror: () => this.#mirror(!this.#view.mirrored),
      flat: () => {
        this.#isFlat = !this.#isFlat;
        this.#view.press("flat", this.#isFlat);
        if (video.paused && this.#view.shown) this.#frame(this.#view.shown.time);
      },
      save: () => {
        saveFile(new Blob([this.#track.csv()], { type: "text/csv" }), `${this.#source.name}_track.csv`);
        if (this.#source.isFile && this.#track.gaps) app.toast(this.#track.gaps);
      },
      seek: (time) => this.#source.seek(time),
    });
    this.#stop();
    const [view, { video }] = [this.#view, this.#source];
    video.addEventListener("play", () => view.meter.reset());
    video.addEventListener("seeking", () => this.#track.leap());
    for (const type of ["play", "pause", "ended"]) video.addEventListener(type, () => this.#dress());
    video.addEventListener("resize", () => view.viewer.setPicture(null, video.videoWidth, video.videoHeight));
    app.state.addEventListener("project", () => this.#dress());
    addEventListener("pagehide", () => this.#end());
    setInterval(() => this.#source.isOpen && this.#tell(), 250);
    setInterval(() => this.#source.isOpen && view.graphs.draw(this.#source, this.#track), GRAPHS);
    window.liaamStudio.live = {
      viewer: view.viewer, shown: () => view.shown, rate: () => view.meter.rate(), delays: () => view.delays,
      track: () => this.#track, recorded: () => this.#recorded.size, video: () => video, isOpen: () => this.#source.isOpen,
      mirrored: () => view.mirrored, camera: () => this.#source.camera, pair: () => view.graphs.pair,
      isIdle: () => this.#inFlight === 0 && this.#missed === null,
    };
  }

  /** @param {{file?: File, camera?: boolean}} options file: a video to follow; camera: whether to follow that */
  show({ file, camera } = {}) {
    if (camera) this.#start(() => this.#source.openCamera());
    else if (file) this.#start(() => this.#source.openFile(file));
    else if (this.#source.isFile) this.#view.drawTime(this.#source.video, this.#track);
  }

  hide() {
    if (this.#source.isFile) return this.#source.pause();
    const lost = several(this.#track.rows.size, "frame");
    if (this.#track.rows.size)
      this.#app.toast(`The camera is off, and its track of ${lost} has ended. Next time, export it before you leave Live.`);
    this.#stop(); // the camera is on only while the tab is open
  }

  key(event) { return isPlain(event) && this.#view.key(event); }

  async #start(open) {
    this.#stop();
    await open().catch((error) => { this.#message = error.message; });
    this.#mirror(this.#source.isFront);
  }

  #stop() {
    this.#recorder?.stop();
    this.#end();
    this.#source.close();
    this.#view.show(null);
    this.#track = new Track();
    this.#message = "";
    this.#dress();
  }

  /** End the server's work on the video; a next frame begins it again. */
  #end() {
    const end = ({ id }) => api.delete(api.url("live/{id}", { id }), {}, { quiet: true, keepalive: true });
    this.#video?.then(end).catch(() => {});
    this.#video = null;
    this.#inFlight = this.#number = 0;
    this.#before = this.#missed = null;
  }

  async #begin() {
    const video = await api.post(api.url("live"), {}, { quiet: true });
    if (this.#track.header !== video.header) this.#track = new Track(video.header); // at first, or with another model
    return video;
  }

  /** A frame is shown: show its fit too if it is known, or else send it. */
  #frame(time) {
    const { video, isFile } = this.#source;
    if (!this.#app.state.project.model || !video.videoWidth) return;
    const known = isFile && !this.#isFlat ? this.#track.at(time) : null;
    const waits = !known && this.#inFlight >= AT_ONCE;
    this.#missed = waits ? time : null;
    if (waits) return;
    const canvas = this.#source.grab(sentSize(video.videoWidth, video.videoHeight));
    const frame = { time, grabbed: performance.now(), canvas, asked: this.#isFlat, run: this.#track.run };
    if (known) this.#take(frame, known, null);
    else this.#send(frame);
  }

  async #send(frame) {
    const { canvas: { width, height }, time } = frame;
    const { videoWidth: of_width, videoHeight: of_height } = this.#source.video;
    const { data } = frame.canvas.getContext("2d").getImageData(0, 0, width, height);
    const fresh = Number(isJump(this.#before, time));
    /** @type {FrameQuery} */
    const query = { width, height, of_width, of_height, number: this.#number, time, fresh, flat: Number(frame.asked) };
    this.#before = time;
    this.#number += 1;
    this.#inFlight += 1;
    const asked = (this.#video ??= this.#begin());
    let answer = null;
    try {
      const { id } = await asked;
      const address = api.url("live/{id}/frames", { id, ...query });
      // A blob is handed over faster than an array.
      answer = await parts(await api.buffer(address, { method: "POST", body: new Blob([data]), quiet: true }));
      this.#message = "";
    } catch (error) {
      if (this.#video === asked) this.#end();
      if (error.status !== 404) this.#message = error.message; // 404: ended for other videos, or by a new model
    }
    if (this.#video === asked) this.#inFlight -= 1;
    if (this.#video === asked && answer) this.#take(frame, ...answer);
    if (this.#missed !== null && this.#source.video.paused) this.#frame(this.#missed);
  }

  #take(frame, row, flat) {
    const fit = this.#track.set(frame.time, row, frame.run);
    if (frame.grabbed < this.#view.shown?.grabbed) return; // overtaken by a newer one
    const { triangles, contours } = this.#app.state.project.model;
    this.#view.show({ ...frame, flat, fit: { ...fit, triangles, contours } });
    if (this.#source.isFile) this.#view.drawTime(this.#source.video, this.#track);
  }

  /** Record the picture with what is drawn over it, until the next call. */
  #record() {
    if (this.#recorder) return this.#recorder.stop();
    if (this.#source.isPaused) return this.#app.toast("The video is not playing, so there is nothing to record: press Play first.");
    const [name, recorded] = [`${this.#source.name}_fit.webm`, []];
    this.#recorded = new Blob();
    const recorder = new MediaRecorder(this.#view.film(this.#source.video), { mimeType: "video/webm" });
    const use = (now) => {
      this.#recorder = now;
      this.#view.press("record", Boolean(now));
    };
    recorder.ondataavailable = ({ data }) => {
      recorded.push(data);
      this.#recorded = new Blob(recorded, { type: "video/webm" });
    };
    recorder.onstop = async () => {
      use(null);
      // The server adds the duration and an index, so that players can seek; a recording too large for it has none.
      const whole = this.#recorded.size && api.blob(api.url("recordings"), { method: "POST", body: this.#recorded });
      if (whole) saveFile(await whole.catch(() => this.#recorded), name);
      else this.#app.toast("Nothing was recorded: record for a second or longer, while the video plays.");
    };
    recorder.start(1000);
    return use(recorder);
  }

  #mirror(on) {
    this.#view.mirror(on);
    this.#dress();
  }

  #dress() {
    this.#view.dress(this.#source, this.#app.state.project?.model);
    this.#tell();
  }

  #tell() {
    const [{ shown, meter }, { isOpen, isFile, isPaused }] = [this.#view, this.#source];
    const [isFlat, fault] = [this.#isFlat, this.#message];
    const rate = meter.isFull && !isPaused ? meter.rate() : null;
    const object = objectOf(this.#app.state.project?.model);
    const wasFound = this.#track.rows.size > this.#track.lost;
    const said = shown ? verdictOfFrame(shown, { isFile, isFlat, rate, object, wasFound })
      : { kind: "", text: isOpen ? "Searching…" : "No video." };
    this.#view.tell(fault ? { kind: "bad", text: fault } : said, this.#track, isFile);
  }
}

/** The row of an answer, and its picture without shading, or null. */
async function parts(buffer) {
  const bytes = new Uint8Array(buffer);
  const end = bytes.indexOf(10) + 1;
  const row = new TextDecoder().decode(bytes.subarray(0, end));
  return [row, end < bytes.length ? await createImageBitmap(new Blob([bytes.subarray(end)])) : null];
}
