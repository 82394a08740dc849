// Files that are dropped or pasted anywhere on the page: pictures to fit, models, and unsaved work of another page.

import { h, icon, isTyping, toast } from "./ui.js";

const carriesFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");

/** take(file): a file was dropped or pasted. */
export function acceptFiles(take) {
  const takeFirst = (files) => {
    const [file, ...others] = files;
    if (others.length) toast(`Only the first of ${others.length + 1} files was opened: ${file.name}`);
    take(file);
  };
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
    takeFirst(event.dataTransfer.files);
  });
  addEventListener("paste", (event) => {
    const files = event.clipboardData?.files;
    if (!files?.length || isTyping(event)) return;
    event.preventDefault();
    takeFirst(files);
  });
}
