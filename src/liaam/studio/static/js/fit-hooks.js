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
    light: () => ({ lamps: view.light.lamps, ambient: view.light.ambient, selected: view.light.selected }),
    relightBusy: () => view.relighter.busy,
    start: () => tab._startTool()?.start ?? null,
    shownShape: () => view.iteration?.shape ?? tab.fit?.shape ?? null,
  };
  const [theta, relit] = [view.invariant.meter, view.relighter.meter];
  const hooks = { viewer: view.viewer, invariantFps: () => theta.rate(), relightFps: () => relit.rate() };
  for (const [name, get] of Object.entries(values)) Object.defineProperty(hooks, name, { get, enumerable: true });
  return hooks;
}
