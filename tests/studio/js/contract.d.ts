// Types of the page's data, written by python -m making.studio_types from src/liaam/studio/contract.py.

/** A curve through points, by index. */
interface Contour {
  indices: number[];
  closed: boolean;
}

/** A picture of the folder, as the list shows it. */
interface Picture {
  name: string;
  /** Changes with the file. */
  tag: string;
  state: "reading" | "broken" | "new" | "unchecked" | "proposed" | "partial" | "done";
  /** Number of its points that have a position. */
  placed: number;
  doubtful: boolean;
  /** Why it cannot be used; this and the following lack while it is read. */
  error?: string | null;
  width?: number | null;
  height?: number | null;
  /** Of its proposal, as the next one. */
  uncertainty?: number | null;
  quality?: number | null;
  /** 1 is the most useful to annotate. */
  rank?: number | null;
  /** Who checked its landmarks. */
  checked?: string | null;
  /** What looks wrong with its landmarks. */
  slip?: string | null;
  /** Indices of these points. */
  slip_points?: number[];
  /** Who left it out of training. */
  left_out?: string | null;
  /** Number of points that the object lacks. */
  absent?: number;
  /** Number of points that no person placed, moved or confirmed one by one. */
  unconfirmed?: number;
  /** Of the landmark file; null if there is none. */
  revision?: string | null;
  /** left or right, as a person or the landmark file says; empty if none does. */
  side?: string;
}

/** The points that are placed on every picture. */
interface Template {
  names: string[];
  kinds: ("landmark" | "semilandmark")[];
  contours: Contour[];
  /** Index of each point's twin, its own on the axis. */
  mirror: number[] | null;
  points: (number[] | null)[] | null;
  revision?: string | null;
}

/** A length in a picture that is known. */
interface Bar {
  ends: number[][];
  length: number;
  unit: string;
}

/** A ruler or a scale bar that is found in a picture. */
interface FoundScale {
  /** From the first tick to the last, or from end to end. */
  bar: Bar;
  /** Length of a pixel, in the unit of the bar. */
  pixel: number;
  /** Its standard error, as a share of it. */
  error: number;
  /** Number of ticks; null of a scale bar. */
  ticks: number | null;
}

/** The landmarks of a picture. */
interface Marks {
  points: (number[] | null)[];
  invisible: number[];
  /** Points that the object lacks. */
  absent: number[];
  /** Where the points of a file come from. */
  origins: ("placed" | "moved" | "confirmed" | "accepted" | "proposed" | null)[] | null;
  source: "file" | "proposal" | "none";
  revision: string | null;
  tag: string;
  file: string | null;
  covariances: number[][][] | null;
  quality: number | null;
  status: string | null;
  doubtful: boolean;
  error: string | null;
  width: number;
  height: number;
  bar: Bar | null;
  /** Changes with the absent points and the origins, which the file does not hold. */
  beside: string;
}

/** What a page has changed from, beside the landmark file. */
interface Base {
  absent?: number[];
  origins?: ("placed" | "moved" | "confirmed" | "accepted" | "proposed" | null)[];
}

/** A request to save the landmarks of a picture. */
interface SaveMarks {
  points: (number[] | null)[];
  invisible?: number[];
  absent?: number[];
  origins?: ("placed" | "moved" | "confirmed" | "accepted" | "proposed" | null)[];
  /** With it, what others have changed meanwhile of other points stays. */
  base?: Base;
  bar?: Bar | null;
  revision: string | null;
  /** Revision of the template of the points. */
  template?: string | null;
  unchecked?: boolean;
  who?: string;
  folder?: string;
}

/** The answer to it. */
interface Saved {
  revision: string | null;
  beside: string;
  /** Whether others had changed absent points or origins, which were kept. */
  merged: boolean;
  picture: Picture;
}

/** What an action on several pictures has done. */
interface Reviewed {
  changed: string[];
  /** Reasons by name. */
  refused: Record<string, string>;
}

/** The answer to a request that says the sides of pictures. */
interface SidesBefore {
  /** What was said of them, by picture; to undo it. */
  before: Record<string, string>;
}

/** Pictures that were removed from the folder, or restored. */
interface Removed {
  /** Restores them. */
  token: string;
  pictures: string[];
}

/** A picture that was renamed. */
interface Renamed {
  before: string;
  name: string;
}

/** An entry in the log of a picture. */
interface HistoryEntry {
  time: string;
  who: string;
  did: string;
  picture: string;
  revision: string | null;
}

/** The sides of the training pictures of a model, such as left and right wings. */
interface Sides {
  /** left, right, or original where it was not stated: the side that the others were reflected to. */
  own: string;
  other: string;
  n_own: number;
  n_other: number;
}

/** The model in use. */
interface Model {
  /** Another one for each model that the server uses. */
  number: number;
  name: string;
  n_images: number;
  n_points: number;
  /** Of its points; none if its training pictures had none. */
  names: string[];
  trained: string | null;
  /** Number of pictures that were completed or changed since. */
  stale: number;
  colour: boolean;
  /** Methods that it can fit with. */
  methods: string[];
  triangles: number[][];
  theta_deg: number;
  contours: Contour[];
  source: "file" | "studio" | "guest" | "face";
  /** Why its training left out pictures that have not changed since, by name. */
  left_out: Record<string, string>;
  mean: number[][];
  /** null: there is one side only, as far as is known. */
  sides: Sides | null;
  /** Whether the side of a training picture was stated or withdrawn since. */
  sides_changed: boolean;
}

/** The state of the training. */
interface Training {
  state: "idle" | "running" | "done" | "failed";
  done: number;
  total: number;
  what: string;
  error: string | null;
}

/** A method that can be fitted with. */
interface Method {
  name: string;
  summary: string;
  needs_colour: boolean;
}

/** A trained model, and its error on pictures that were held out. */
interface Version {
  time: string | null;
  pictures: number;
  error: number;
  held_out: number;
  /** Whether it was measured on the pictures of the newest. */
  same: boolean;
}

/** How much of some work is done. */
interface Counted {
  done: number;
  total: number;
}

/** Suffixes of the files that can be added. */
interface Formats {
  pictures: string[];
  landmarks: string[];
  videos: string[];
}

/** The largest files and pictures that can be added. */
interface Limits {
  upload_bytes: number;
  pixels: number;
}

/** The folder, as the page shows it. */
interface Project {
  id: string;
  stamp: string;
  folder: string;
  /** Whether nothing can be written, so that pictures are only shown, fitted and relit. */
  read_only: boolean;
  /** The set of landmarks that the page shows. */
  set: string;
  /** All sets of the folder; '' is the first one. */
  sets: string[];
  /** The sets of the same points, if there are several. */
  observers: string[];
  version: string;
  pictures: Picture[];
  template: Template | null;
  /** Whether a model offers the template, and it was not accepted yet. */
  offered: boolean;
  model: Model | null;
  /** Whether slips were looked for in the landmarks as they are. */
  checked: boolean;
  training: Training;
  /** Oldest first. */
  versions: Version[];
  methods: Method[];
  default_method: string;
  default_ambient: number;
  /** Pictures that are being fitted as they arrive. */
  fitting: Counted | null;
  formats: Formats;
  limits: Limits;
  problems: string[];
}

/** The answer if nothing has changed since a stamp. */
interface Unchanged {
  unchanged: true;
  stamp: string;
}

/** A measure of all pictures with landmarks. */
interface Column {
  /** Such as distance:1-5; null: the centroid size. */
  measure: string | null;
  name: string;
  /** px, °, or a unit of length or area. */
  unit: string;
  /** null: a landmark is missing, or the picture has no scale. */
  values: (number | null)[];
}

/** A grid over the mean shape, and how its points move with each principal component. */
interface Grid {
  rows: number;
  columns: number;
  points: number[][];
  /** For a score of 1, by component. */
  bends: number[][][];
}

/** The space of shapes, of centroid size 1, y downwards as in pictures. */
interface Space {
  /** Indices of the points that make the shape. */
  landmarks: number[];
  /** Indices of the pictures that have a shape. */
  of: number[];
  mean: number[][];
  /** Those of the first of them, to be drawn over each other. */
  shapes: number[][][];
  /** By picture, of each principal component. */
  scores: number[][];
  /** By component: the mean plus scores times axes is a shape. */
  axes: number[][][];
  shares: number[];
  /** From the mean shape, in centroid sizes. */
  distances: number[];
  /** Distance beyond which a shape is unusual. */
  limit: number;
  /** null: the landmarks lie on one line. */
  grid: Grid | null;
}

/** A permutation test of the difference in shape between groups. */
interface GroupTest {
  groups: string;
  specimens: number;
  /** Between the mean shapes of two groups, in centroid sizes. */
  distance: number | null;
  /** Of the groups in the variance of shape. */
  share: number;
  p: number;
}

/** Measures of all pictures with landmarks, and the space of their shapes. */
interface Shapes {
  pictures: string[];
  /** Group of each; empty if it has none. */
  groups: string[];
  /** Number of points of each that were estimated. */
  estimated: number[];
  columns: Column[];
  space: Space | null;
  /** Why there is no space. */
  why_not: string;
  /** What was done about left and right; empty if nothing. */
  sides: string;
  tests: GroupTest[];
  /** Whether a table of groups was given. */
  has_table: boolean;
}

/** How shapes agree with labels, for statistics of shape. */
interface ShapeAgreement {
  /** Of the two: shapes and labels. */
  names: string[];
  pictures: number;
  /** Of the shapes on the labels. */
  slope: number;
  slope_interval: number[];
  /** What a difference between groups is multiplied by; null without groups. */
  attenuation: number | null;
  attenuation_interval: (number | null)[];
  variance_ratio: number;
  reliability: number;
  /** Intraclass correlation. */
  repeatability: number;
  /** Of the mean shapes, in standard errors. */
  mean_distance: number;
  /** That the mean shapes are as far apart by chance. */
  p: number;
  size_correlation: number;
  /** Sentences for the section Methods of a paper. */
  methods: string;
}

/** How far observers are apart. */
interface Agreement {
  observers: string[];
  sd: number;
  percent: number;
  repeatability: number | null;
  /** Name, deviation in pixels, and in percent of the size. */
  points: ([string, number, number])[];
  /** Name and deviation. */
  pictures: ([string, number])[];
  /** Pictures that do not count, since points were accepted as they were proposed. */
  unconfirmed: string[];
  file: string;
  table: string;
  /** Of each other observer and the set that is shown, from 5 pictures on. */
  shapes: ShapeAgreement[];
}

/** The landmarks of a picture were saved, by any page. */
interface LandmarksChanged {
  name: string;
  /** null or empty: there is no file any more. */
  revision: string | null;
  /** Changes with what is kept beside the file. */
  beside?: string;
}

/** The answer to a request that is refused or has failed. */
interface Fault {
  /** What is wrong, and what to do, in a sentence for the person. */
  error: string;
  /** The page shows another folder than this one, by its id. */
  folder?: string;
  /** The landmarks, which were changed since the page read them. */
  current?: Marks;
  /** The template, which was changed since the page read it. */
  template?: Template | null;
}

/** Data of the events that the server sends, by kind. */
interface Events {
  project: Record<string, any>;
  training: Training;
  fitting: Counted | null;
  landmarks: LandmarksChanged | LandmarksChanged[];
}
