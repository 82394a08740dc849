// Types of the page for JSDoc; those of its data are in contract.d.ts.

/** A position in pixels of the picture; null: not placed. */
type Point = number[] | null;

/** An address of the server, of one of its routes. */
type Address<R extends keyof Routes> = string & { readonly route: R };

/** The last arguments of `url`: what varies in an address may lack if nothing has to be said. */
type Given<Fields> = {} extends Fields ? [fields?: Fields] : [fields: Fields];

/** The routes that answer a method with JSON, or with a file. */
type Answering<Method extends string> =
  { [R in keyof Routes]: Routes[R] extends Record<Method, { answer: any }> ? R : never }[keyof Routes];
type Filing<Method extends string> =
  { [R in keyof Routes]: Routes[R] extends Record<Method, { file: Blob }> ? R : never }[keyof Routes];

/** What a route takes and answers by a method. */
type Taken<R extends keyof Routes, Method extends string> =
  Routes[R] extends Record<Method, { body: infer Body }> ? Body : Record<string, never>;
type Answered<R extends keyof Routes, Method extends string> =
  Routes[R] extends Record<Method, { answer: infer Answer }> ? Answer : never;

/** Options of a request. quiet: nobody waits for the answer, so no progress is shown. */
type Options = RequestInit & { quiet?: boolean };

/** Sends JSON by a method. */
type SendJson<Method extends string> = <R extends Answering<Method>>(
  address: Address<R>, body?: Taken<R, Method>, options?: Options) => Promise<Answered<R, Method>>;

/** The server's HTTP interface. */
interface Api {
  url: <R extends keyof Routes>(route: R, ...given: Given<Routes[R]["fields"]>) => Address<R>;
  get: <R extends Answering<"GET">>(address: Address<R>, options?: Options) => Promise<Answered<R, "GET">>;
  put: SendJson<"PUT">;
  post: SendJson<"POST">;
  delete: SendJson<"DELETE">;
  upload: <R extends Answering<"POST">>(
    address: Address<R>, file: Taken<R, "POST"> & Blob, options?: Options) => Promise<Answered<R, "POST">>;
  buffer: (address: Address<Filing<"GET"> | Filing<"POST">>, options?: Options) => Promise<ArrayBuffer>;
  blob: (address: Address<Filing<"GET"> | Filing<"POST">>, options?: Options) => Promise<Blob>;
  layer: (address: Address<Filing<"GET">>) => Promise<{ image: ImageBitmap; scale: Partial<ColourScale & LayerChange & LayerPlace> | null }>;
  file: (address: string, options?: Options) => Promise<[Blob, string]>;
  landmarks: (kind: string) => Promise<{ file: [Blob, string], hasBothSides: boolean }>;
}

/** What the tabs get from main.js. */
interface App {
  state: import("../../../src/liaam/studio/static/js/state.js").State;
  api: Api;
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
  /** The picture that the open tab shows, if it is not in the folder, or null. */
  aside(): import("../../../src/liaam/studio/static/js/fit-source.js").Source | null;
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
