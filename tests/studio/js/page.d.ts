// Types of the page's data, for JSDoc. The server's Python writes the JSON.

/** A position in pixels of the picture; null: not placed. */
type Point = number[] | null;

interface Contour {
  indices: number[];
  closed: boolean;
}

/** A picture of the folder, as the list shows it. */
interface Picture {
  name: string;
  tag: string;
  state: string;
  placed: number;
  width: number | null;
  height: number | null;
  uncertainty: number | null;
  /** Of its proposal. */
  quality: number | null;
  /** What looks wrong with its landmarks. */
  slip: string | null;
  /** Indices of its points. */
  slip_points: number[];
  doubtful: boolean;
  rank: number | null;
  error: string | null;
  /** Who checked its landmarks, and who left it out of training. */
  checked: string | null;
  left_out: string | null;
  /** Of the landmark file; null if there is none. */
  revision: string | null;
}

interface Template {
  names: string[];
  contours: Contour[];
  mirror: number[] | null;
  points: Point[] | null;
  revision: string;
}

interface Model {
  /** Another one for each model that the server uses. */
  number: number;
  name: string;
  n_images: number;
  n_points: number;
  /** Of its points; none if its training pictures had none. */
  names: string[];
  trained: string | null;
  stale: number;
  colour: boolean;
  /** Methods that it can fit with. */
  methods: string[];
  triangles: number[][];
  theta_deg: number;
  contours: Contour[];
  source: "file" | "studio" | "guest" | "face";
  left_out: Record<string, string>;
  mean: number[][];
}

interface Training {
  state: "idle" | "running" | "done" | "failed";
  done: number;
  total: number;
  what: string;
  error: string | null;
}

interface Method {
  name: string;
  summary: string;
  needs_colour: boolean;
}

interface Project {
  id: string;
  stamp?: string;
  folder: string;
  /** The set of landmarks that the page shows, and all of the folder; "" is the first one. */
  set: string;
  sets: string[];
  /** The sets of the same points, if there are several. */
  observers: string[];
  version: string;
  pictures: Picture[];
  template: Template | null;
  /** Whether a model offers the template, and nobody has accepted it. */
  offered: boolean;
  model: Model | null;
  training: Training;
  /** Whether slips were looked for in the landmarks as they are. */
  checked: boolean;
  /** Trained models, oldest first; same: measured on the pictures of the newest. */
  versions: { time: string; pictures: number; error: number; held_out: number; same: boolean }[];
  methods: Method[];
  default_method: string;
  default_ambient: number;
  /** Pictures that are being fitted as they arrive. */
  fitting: { done: number; total: number } | null;
  /** Suffixes of the files that can be added. */
  formats: { pictures: string[]; landmarks: string[]; videos: string[] };
  limits: { upload_bytes: number; pixels: number };
  problems: string[];
}

/** Marks of a picture as the server sends them. */
interface Marks {
  points: Point[];
  invisible: number[];
  source: "file" | "proposal" | "none";
  revision: string | null;
  width: number;
  height: number;
  covariances?: number[][][] | null;
  doubtful?: boolean;
  /** A length in the picture that is known. */
  bar: { ends: number[][]; length: number; unit: string } | null;
}

/** What the tabs get from main.js. */
interface App {
  state: import("../../../src/liaam/studio/static/js/state.js").State;
  api: typeof import("../../../src/liaam/studio/static/js/api.js").api;
  ui: typeof import("../../../src/liaam/studio/static/js/ui.js");
  toast: typeof import("../../../src/liaam/studio/static/js/ui.js").toast;
  confirm: typeof import("../../../src/liaam/studio/static/js/ui.js").confirm;
  openTab(name: string, options?: object): void;
  /** Bringing files in. */
  adding: any;
  /** Actions on several pictures. */
  bulk: any;
  /** Resolves once all moved points are saved, or cannot be. */
  saved(): Promise<any>;
  /** Indices of the selected points of the open picture. */
  selection(): number[];
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
