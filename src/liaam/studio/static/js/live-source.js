// A camera or a video file, frame by frame.

import { h } from "./ui.js";

const CAMERA = { audio: false, video: { width: { ideal: 640 }, height: { ideal: 480 }, facingMode: "user" } };

const FAULTS = {
  NotAllowedError: "The browser does not let this page use the camera. Allow it beside the address, and try again.",
  NotFoundError: "There is no camera. Connect one, or open a video.",
  NotReadableError: "The camera does not answer. If another program uses it, close that program, and try again.",
};

const HELD = 4; // frames that are shown or sent at a time

export class LiveSource {
  /** onframe is called with the time in seconds of each frame that is shown. */
  constructor(onframe) {
    /** @type {HTMLVideoElement} */
    this.video = h("video", { muted: true, playsInline: true });
    this.name = "";
    this.isFile = false;
    this._canvases = Array.from({ length: HELD }, () => h("canvas"));
    const follow = () => this.video.requestVideoFrameCallback((_, { mediaTime }) => {
      onframe(mediaTime);
      follow();
    });
    follow();
  }

  get isOpen() { return Boolean(this.video.srcObject || this.video.src); }

  /** Show the camera; errors have a message for the user. */
  async openCamera() {
    if (!navigator.mediaDevices)
      throw new Error("Browsers allow cameras at 127.0.0.1 or by https only: open the page there.");
    try {
      this.video.srcObject = await navigator.mediaDevices.getUserMedia(CAMERA);
    } catch (error) {
      throw new Error(FAULTS[error.name] ?? `The camera cannot be used (${error.message}). Open a video instead.`);
    }
    this.name = "camera";
    await this.video.play();
  }

  /** Show a video file; errors have a message for the user. */
  async openFile(file) {
    Object.assign(this, { name: file.name.replace(/\.[^.]*$/, ""), isFile: true });
    this.video.src = URL.createObjectURL(file);
    try {
      await this.video.play();
    } catch {
      this.close();
      throw new Error(`The browser cannot play ${file.name}. Convert it to .mp4 or .webm, or use 'liaam track'.`);
    }
  }

  /** Stop, and turn the camera off. */
  close() {
    for (const track of /** @type {any} */ (this.video.srcObject)?.getTracks() ?? []) track.stop();
    if (this.video.src) URL.revokeObjectURL(this.video.src);
    this.video.srcObject = null;
    this.video.removeAttribute("src");
    this.isFile = false;
  }

  /** The current frame in a canvas, which is used again for the fourth frame after it. */
  grab({ width, height }) {
    const canvas = this._canvases.shift();
    this._canvases.push(canvas);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    // The pixels are read at once, which is slow from the memory of a graphics card.
    canvas.getContext("2d", { willReadFrequently: true }).drawImage(this.video, 0, 0, width, height);
    return canvas;
  }
}
