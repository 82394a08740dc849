// A camera or a video file, frame by frame.

import { h } from "./ui.js";

const SIZE = { width: { ideal: 640 }, height: { ideal: 480 } };
const KEY = "liaam-studio:camera"; // the camera that was chosen last

const FAULTS = {
  NotAllowedError: "The browser does not let this page use the camera. Allow it beside the address, and try again.",
  NotFoundError: "There is no camera. Connect one, or open a video.",
  NotReadableError: "The camera does not answer. If another program uses it, close that program, and try again.",
};

const HELD = 4; // frames that are shown or sent at a time

export class LiveSource {
  #name = "";
  #isFile = false;
  #isFront = false;
  #camera = "";
  #cameras = {};
  #canvases;

  /** onframe is called with the time in seconds of each frame that is shown. */
  constructor(onframe) {
    /** @type {HTMLVideoElement} */
    this.video = h("video", { muted: true, playsInline: true });
    this.#canvases = Array.from({ length: HELD }, () => h("canvas"));
    const follow = () => this.video.requestVideoFrameCallback((_, { mediaTime }) => {
      onframe(mediaTime);
      follow();
    });
    follow();
  }

  get name() { return this.#name; }
  get isFile() { return this.#isFile; }
  /** Whether it is a camera that looks at the person who sees its picture. */
  get isFront() { return this.#isFront; }
  /** Id of the open camera. */
  get camera() { return this.#camera; }
  /** Names of the cameras by id, known once one was open. */
  get cameras() { return this.#cameras; }
  get isPaused() { return this.video.paused; }
  get isOpen() { return Boolean(this.video.srcObject || this.video.src); }

  pause() { this.video.pause(); }

  /** Play, or pause. */
  toggle() {
    if (this.video.paused) this.video.play().catch(() => {});
    else this.pause();
  }

  /** Show the frame at a time in seconds. */
  seek(time) {
    this.video.currentTime = time;
    this.pause();
  }

  /** Show a camera, by default the one that was chosen last; errors have a message for the user. */
  async openCamera(chosen = localStorage.getItem(KEY)) {
    if (!navigator.mediaDevices)
      throw new Error("Browsers allow cameras at 127.0.0.1 or by https only: open the page there.");
    if (chosen) localStorage.setItem(KEY, chosen);
    const which = chosen ? { deviceId: { ideal: chosen } } : { facingMode: "user" };
    try {
      this.video.srcObject = await navigator.mediaDevices.getUserMedia({ audio: false, video: { ...SIZE, ...which } });
    } catch (error) {
      throw new Error(FAULTS[error.name] ?? `The camera cannot be used (${error.message}). Open a video instead.`);
    }
    const { facingMode, deviceId } = /** @type {any} */ (this.video.srcObject).getVideoTracks()[0].getSettings();
    const all = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "videoinput");
    this.#cameras = Object.fromEntries(all.map((each, i) => [each.deviceId, each.label || `Camera ${i + 1}`]));
    this.#name = "camera";
    this.#camera = deviceId;
    this.#isFront = facingMode !== "environment";
    await this.video.play();
  }

  /** Show a video file; errors have a message for the user. */
  async openFile(file) {
    this.#name = file.name.replace(/\.[^.]*$/, "");
    this.#isFile = true;
    this.video.src = URL.createObjectURL(file);
    try {
      await this.video.play();
    } catch {
      this.close();
      const remedy = "Convert it to .mp4 with the codec H.264, or to .webm, or use 'liaam track'.";
      throw new Error(`The browser cannot play ${file.name}: it does not know how the video is compressed. ${remedy}`);
    }
  }

  /** Stop, and turn the camera off. */
  close() {
    for (const track of /** @type {any} */ (this.video.srcObject)?.getTracks() ?? []) track.stop();
    if (this.video.src) URL.revokeObjectURL(this.video.src);
    this.video.srcObject = null;
    this.video.removeAttribute("src");
    this.#isFile = this.#isFront = false;
  }

  /** The current frame in a canvas, which is used again for the fourth frame after it. */
  grab({ width, height }) {
    const canvas = this.#canvases.shift();
    this.#canvases.push(canvas);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    // The pixels are read at once, which is slow from the memory of a graphics card.
    canvas.getContext("2d", { willReadFrequently: true }).drawImage(this.video, 0, 0, width, height);
    return canvas;
  }
}
