// Hooks of the Fit tab for browser tests and benchmarks.

/** `lastDropMs` from the newest drop to the first frame painted with its fit, frames per second of the newest drag of theta,
 *  and the displayed values. */
export function hooksOf(tab) {
  const { view } = tab;
  const values = {
    lastDropMs: () => tab.lastDropMs,
    fit: () => tab.fit,
    view: () => view.name,
    hasLayer: () => view._image() !== null, // whether the view's own image has come
    theta: () => view.invariant.theta,
    light: () => ({ direction: view.light.direction, ambient: view.light.ambient }),
    relightBusy: () => view.relighter.busy,
    start: () => tab._startTool()?.start ?? null,
    shownShape: () => view.iteration?.shape ?? tab.fit?.shape ?? null,
  };
  const hooks = { viewer: view.viewer, invariantFps: () => view.invariant.meter.rate() };
  for (const [name, get] of Object.entries(values)) Object.defineProperty(hooks, name, { get, enumerable: true });
  return hooks;
}
