// Plots of the page as SVG files, which look the same without the page's style sheets.

import { attempt } from "./unsaved.js";

const GROUND = ".shape-plot { color: #444; background: #fff; }"; // where the page's theme may be dark

/** Rules of all style sheets of the page; a browser refuses those of another origin, as of an extension. */
const rulesOfPage = () => [...document.styleSheets].flatMap((sheet) => attempt(() => [...sheet.cssRules], []));

/** The rules for plots, with the values of the theme in place of its variables. */
function plotStyle() {
  const rules = rulesOfPage().map(({ cssText }) => cssText);
  const forPlots = rules.filter((rule) => rule.startsWith(".plot-") || rule.startsWith(".shape-plot"));
  const theme = getComputedStyle(document.documentElement);
  const withValues = (rule) => rule.replace(/var\((--[a-z-]+)\)/g, (_, name) => theme.getPropertyValue(name));
  return [GROUND, ...forPlots].map(withValues).join("\n");
}

/** The plots of an element as files, without those for clicking points. @returns {Blob[]} */
export function plotFiles(/** @type {HTMLElement} */ element) {
  const style = plotStyle();
  const plots = [...element.querySelectorAll("svg.shape-plot")].filter((plot) => !plot.querySelector(".plot-pick"));
  return plots.map((plot) => {
    const copy = plot.cloneNode(true);
    const sheet = document.createElementNS("http://www.w3.org/2000/svg", "style");
    sheet.textContent = style;
    /** @type {SVGElement} */ (copy).prepend(sheet);
    return new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" });
  });
}
