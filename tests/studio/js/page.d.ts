// Types of the page for JSDoc; those of its data are in contract.d.ts.

/** A position in pixels of the picture; null: not placed. */
type Point = number[] | null;

/** What the tabs get from main.js. */
interface App {
  state: import("../../../src/liaam/studio/static/js/state.js").State;
  api: typeof import("../../../src/liaam/studio/static/js/api.js").api;
  ui: typeof import("../../../src/liaam/studio/static/js/ui.js");
  toast: typeof import("../../../src/liaam/studio/static/js/ui.js").toast;
  confirm: typeof import("../../../src/liaam/studio/static/js/ui.js").confirm;
  openTab(name: string, options?: object): void;
  /** Bringing files in. */
  adding: ReturnType<typeof import("../../../src/liaam/studio/static/js/adding.js").createAdding>;
  /** The list of the pictures, the wall, and actions on several pictures. */
  list: ReturnType<typeof import("../../../src/liaam/studio/static/js/strip.js").mountStrip>;
  /** Resolves once all moved points are saved, or cannot be. */
  saved(): Promise<any>;
  /** The points that the Annotate tab shows. */
  points(): Point[];
  showsPictures(): boolean;
  pictures: import("../../../src/liaam/studio/static/js/fit-source.js").PictureStore;
  /** The picture to fit and the fits, shared by the tabs Fit and Compare. */
  sources: import("../../../src/liaam/studio/static/js/fit-source.js").Sources;
  fits: import("../../../src/liaam/studio/static/js/fit-run.js").FitStore;
}

/** Hooks for browser tests, and the theme. */
interface Window {
  liaamStudio: any;
  liaamTheme: any;
  liaamPanels: any;
}
