// Hooks of the Fit tab for browser tests and benchmarks.

/** `lastDropMs` from the newest drop to the first frame painted with its fit, frames per second of the newest drag, and
 *  the displayed values. */
export function hooksOf(tab) {
  const { view } = tab;
  return {
    viewer: view.viewer, invariantFps: () => view.invariant.meter.rate(), relightFps: () => view.meter.rate(),
    get lastDropMs() { return tab.lastDropMs; },
    get fit() { return tab.fit; },
    get view() { return view.name; },
    get hasLayer() { return view._image() !== null; }, // whether the view's own image has come
    get theta() { return view.invariant.theta; },
    get light() { return { lamps: view.light.lamps, ambient: view.light.ambient, selected: view.light.selected }; },
    get relightBusy() { return view._awaited !== null; },
    get start() { return tab._startTool()?.start ?? null; },
    get shownShape() { return view.iteration?.shape ?? tab.fit?.shape ?? null; },
  };
}
