// Common sets of landmarks to start a template with.

import { h } from "./ui.js";

const PRESETS = {
  "face-68": "Face, 68 points (iBUG)", "body-17": "Body, 17 points (COCO)", "hand-21": "Hand, 21 points",
  "wing-12": "Fly wing, 12 points on veins",
};

/** A list to choose from; onload(file): load the landmark file of the chosen set. */
export function createPresets(onload) {
  const options = Object.entries(PRESETS).map(([value, label]) => h("option", { value }, label));
  const onchange = async () => {
    const name = `${choice.value}.ljson`;
    choice.value = "";
    onload(new File([await (await fetch(`presets/${name}`)).blob()], name));
  };
  const choice = h("select.text", { "aria-label": "Common sets of points", testid: "template-preset", onchange },
    h("option", { value: "" }, "Choose a common set…"), options);
  return choice;
}
