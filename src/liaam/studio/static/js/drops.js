// Files that are dropped or pasted anywhere on the page: pictures to fit, models, and unsaved work of another page.

import { h, icon, isTyping } from "./ui.js";

const carriesFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");

/** take(file): a file was dropped or pasted. */
export function acceptFiles(take) {
  let depth = 0; // number of nested elements under a drag
  const words = h("p", icon("upload", 28), "Drop a picture to fit it, or a model (.liaam)");
  const overlay = h("div.dropping", { hidden: true, "aria-hidden": "true" }, words);
  document.body.append(overlay);
  const enter = (now) => {
    depth = Math.max(0, now);
    overlay.hidden = depth === 0;
  };
  addEventListener("dragenter", (event) => carriesFiles(event) && enter(depth + 1));
  addEventListener("dragleave", (event) => carriesFiles(event) && enter(depth - 1));
  addEventListener("dragover", (event) => {
    if (!carriesFiles(event)) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "copy";
  });
  addEventListener("drop", (event) => {
    if (!carriesFiles(event)) return;
    event.preventDefault();
    enter(0);
    take(event.dataTransfer.files[0]);
  });
  addEventListener("paste", (event) => {
    const file = event.clipboardData?.files[0];
    if (!file || isTyping(event)) return;
    event.preventDefault();
    take(file);
  });
}
