// Files and folders that are dropped or pasted anywhere on the page.

import { filesIn } from "./adding.js";
import { h, icon, isTyping, toast } from "./ui.js";

const carriesFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");

/** take([{file, path}]): files were dropped or pasted. */
export function acceptFiles(take) {
  const takeAll = (transfer) => filesIn(transfer).then(take).catch((error) => toast(error, "bad"));
  let depth = 0; // number of nested elements under a drag
  const words = h("p", icon("upload", 28), "Drop pictures, folders, landmark files, a model or a video");
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
    takeAll(event.dataTransfer);
  });
  addEventListener("paste", (event) => {
    const files = event.clipboardData?.files;
    if (!files?.length || isTyping(event)) return;
    event.preventDefault();
    takeAll(event.clipboardData);
  });
}
