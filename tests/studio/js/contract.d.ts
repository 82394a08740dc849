// Types of the page's data, written by python -m making.studio_types from src/liaam/studio/contract.py.

/** A curve through points, by index. */
interface Contour {
  indices: number[];
  closed: boolean;
  /** What a person calls it; empty if nothing. */
  name?: string;
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
  /** Whether its proposal is a guess: the model finds no object in it. */
  nothing_found?: boolean;
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
  /** Number of these that no person accepted either, so that it is not done. */
  proposed?: number;
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

/** A request to save the template, and to change all landmark files with it. */
interface SaveTemplate {
  /** Id of the folder that the page shows. */
  folder?: string;
  names: string[];
  kinds?: ("landmark" | "semilandmark")[] | null;
  contours?: Contour[] | null;
  mirror?: number[] | null;
  /** A typical layout. */
  points?: (number[] | null)[] | null;
  /** The old index of each point, null of a new one. */
  mapping?: (number | null)[] | null;
  /** Of the template that was changed. */
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

/** The scale bar of all pictures that have a scale, if these are several and it is one. */
interface SharedScale {
  bar: Bar | null;
  /** A picture that has it; empty without one. */
  of: string;
  /** The pictures of its size that have no scale. */
  without: string[];
}

/** The length of a pixel. */
interface Pixel {
  length: number;
  unit: string;
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
  /** Of the points that the model proposes, even beside a file. */
  covariances: number[][][] | null;
  /** These points, which the covariances belong to. */
  fitted: (number[] | null)[] | null;
  quality: number | null;
  status: string | null;
  doubtful: boolean;
  error: string | null;
  width: number;
  height: number;
  bar: Bar | null;
  /** Whether it was drawn on another picture, so that its place here means nothing. */
  bar_shared: boolean;
  /** By the scale of the landmark file, or that of Measure, where there is no bar. */
  pixel: Pixel | null;
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
  /** Id of the folder that the page shows. */
  folder?: string;
  points: (number[] | null)[];
  invisible?: number[];
  absent?: number[];
  origins?: ("placed" | "moved" | "confirmed" | "accepted" | "proposed" | null)[] | null;
  /** With it, what others have changed meanwhile of other points stays. */
  base?: Base | null;
  bar?: Bar | null;
  revision: string | null;
  /** Revision of the template of the points. */
  template?: string | null;
  /** Whether a picture without points was left at the mean shape. */
  unchecked?: boolean;
  who?: string | null;
}

/** The answer to it. */
interface Saved {
  revision: string | null;
  beside: string;
  /** Whether others had changed absent points or origins, which were kept. */
  merged: boolean;
  picture: Picture;
}

/** A request to do something to several pictures. */
interface Review {
  /** Id of the folder that the page shows. */
  folder?: string;
  pictures: string[];
  did: string;
  who?: string | null;
  /** For the action scaled. */
  bar?: Bar | null;
  /** The picture on which it was drawn. */
  of?: string | null;
  /** Whether pictures of another size, or with a scale of their own, get it as well. */
  anyway?: boolean;
}

/** What an action on several pictures has done. */
interface Reviewed {
  changed: string[];
  /** Reasons by name. */
  refused: Record<string, string>;
}

/** A request to say the sides of the objects in pictures. */
interface SaveSides {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** left, right, or empty to withdraw what was said, by picture. */
  sides: Record<string, string>;
}

/** The side of the object in a picture, and whether all pictures show the same. */
interface FoundSide {
  /** left, right, original or mirrored, as stated, by its name or its shape; empty if not known. */
  side: string;
  /** Whether the pictures show two sides, as far as is known. */
  both: boolean;
}

/** The answer to a request that says the sides of pictures. */
interface SidesBefore {
  /** What was said of them, by picture; to undo it. */
  before: Record<string, string>;
}

/** A request to remove pictures from the folder. */
interface RemovePictures {
  /** Id of the folder that the page shows. */
  folder?: string;
  pictures: string[];
}

/** A request to bring removed pictures back. */
interface RestorePictures {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** As the answer to the removal has it. */
  token: string;
}

/** A request to rename a picture. */
interface RenamePicture {
  /** Id of the folder that the page shows. */
  folder?: string;
  picture: string;
  /** As a person has typed it. */
  to: string;
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

/** A file that was added to the folder. */
interface Added {
  /** In the folder. */
  name: string;
  kind: "picture" | "landmarks";
  /** Whether the same file was there before. */
  known: boolean;
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

/** A request to train. */
interface StartTraining {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** Whether to train on points that look wrong, too. */
  slips?: boolean;
}

/** A request to stop the training. */
interface StopTraining {
  /** Id of the folder that the page shows. */
  folder?: string;
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
  /** Median of the fits that have not failed; if all have, of these. */
  error: number;
  held_out: number;
  /** Held-out pictures whose fits failed, and said so. */
  failed: string[];
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
  /** Of flat and relit pictures that are saved; larger ones are reduced to it. */
  relit_pixels: number;
}

/** What is measured of the pictures, as it is kept with the folder. */
interface Measuring {
  /** Such as distance:1-5, with numbers of points. */
  measures: string[];
  /** Of pictures that have none, such as 0.005 mm, or of all, such as 11-12=5 mm; else empty. */
  scale: string;
  /** What groups pictures: folder, name or table; empty if nothing. */
  by: string;
  /** What a person calls measures, by measure. */
  names: Record<string, string>;
  /** What a change of the template has removed with its points, in words. */
  gone: string[];
}

/** A request to change what is measured. */
interface SaveMeasuring {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** Measures, with numbers or names of points. */
  add?: string[];
  /** Measures as they are kept. */
  remove?: string[];
  /** New names of measures; an empty one takes the name away. */
  names?: Record<string, string>;
  scale?: string;
  by?: string;
  /** Whether what is gone was seen, and need not be said again. */
  seen?: boolean;
}

/** A request to use the face model instead of the folder's own, or that one again. */
interface UseModel {
  /** Id of the folder that the page shows. */
  folder?: string;
  source: "face" | "studio";
}

/** A request to keep the name of the person who works in the page. */
interface SaveWho {
  /** Id of the folder that the page shows. */
  folder?: string;
  who: string;
}

/** The name of the person who works in the page. */
interface Who {
  who: string;
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
  /** Whether faces are being looked for: then the face model offers its points. */
  looking: boolean;
  model: Model | null;
  /** Whether the face model can be used instead of the folder's own. */
  face_again: boolean;
  /** Whether a person went back to the face model: none is trained by itself. */
  set_aside: boolean;
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
  measuring: Measuring;
  /** The name that a person last gave in this set of landmarks; empty if none did. */
  who: string;
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
  /** What a person calls it; empty if nothing. */
  called: string;
  name: string;
  /** px, °, or a unit of length or area. */
  unit: string;
  /** null: a landmark is missing, or the picture has no scale. */
  values: (number | null)[];
  /** That the means of the groups differ so by chance; null without two groups. */
  p: number | null;
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

/** A request to keep a table of groups. */
interface SaveGroups {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** Of a .csv file. */
  text: string;
  /** Of that file. */
  name: string;
}

/** A table of groups that was kept. */
interface Grouped {
  /** Number of those in the table. */
  specimens: number;
}

/** Measures of all pictures with landmarks, and the space of their shapes. */
interface Shapes {
  pictures: string[];
  /** Group of each; empty if it has none. */
  groups: string[];
  /** Number of points of each that were estimated. */
  estimated: number[];
  /** Indices of pictures without a scale, where others have one. */
  unscaled: number[];
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

/** A request to make a further set of landmarks. */
interface MakeSet {
  /** Id of the folder that the page shows. */
  folder?: string;
  name: string;
  /** Whether it has the points of the set that the page shows. */
  same?: boolean;
}

/** A set of landmarks that was made. */
interface MadeSet {
  name: string;
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
  /** Of all these pictures; null if some have no scale, or another one. */
  pixel: Pixel | null;
  sd: number;
  percent: number;
  repeatability: number | null;
  /** Name, deviation in pixels, and in percent of the size. */
  points: ([string, number, number])[];
  /** Name and deviation. */
  pictures: ([string, number])[];
  /** Pictures that do not count, since points were accepted as they were proposed. */
  unconfirmed: string[];
  /** The only observer who has placed all points of a picture, by other pictures. */
  alone: Record<string, string>;
  file: string;
  table: string;
  /** Of each other observer and the set that is shown, from 5 pictures on. */
  shapes: ShapeAgreement[];
}

/** Where a fit starts: a box, or a shape. */
interface Start {
  /** Left, top, right and bottom. */
  box?: number[] | null;
  shape?: (number[] | null)[] | null;
}

/** A request to fit all specimens of a picture, either of the folder or dropped. */
interface FitAll {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** Name of a picture of the folder. */
  picture?: string | null;
  /** Id of a dropped one. */
  upload?: string | null;
  method?: string;
  /** Of the object: auto, or one of the model's. */
  side?: string;
}

/** A request to fit the object in a picture. */
interface FitOne {
  /** Id of the folder that the page shows. */
  folder?: string;
  /** Name of a picture of the folder. */
  picture?: string | null;
  /** Id of a dropped one. */
  upload?: string | null;
  method?: string;
  /** Of the object: auto, or one of the model's. */
  side?: string;
  /** null: the object is searched for. */
  start?: Start | null;
}

/** How long the parts of a fit took. */
interface Seconds {
  search: number;
  fit: number;
}

/** How an object was found. */
interface Found {
  score: number;
  doubtful: boolean;
}

/** An iteration of a fit. */
interface Iteration {
  shape: ((number | null)[])[];
  level: number;
  cost: number | null;
  theta_deg: number | null;
}

/** The mean distance of a fit from the landmarks of the picture. */
interface FitError {
  pixels: number;
  /** Of the diagonal of the landmarks. */
  percent: number;
}

/** Which of several specimens a fit is of. */
interface Specimen {
  /** From 1, in reading order. */
  number: number;
  name: string;
  /** What is not clear about it; empty if nothing. */
  fault: string;
}

/** A fit to a picture, in its pixels. Numbers that are not finite are null. */
interface Fit {
  id: string;
  method: string;
  status: string;
  /** Whether its landmarks may be used. */
  ok: boolean;
  message: string;
  quality: number | null;
  side: string | null;
  theta_deg: number | null;
  cost: number | null;
  /** Number of objects that the search has found in the picture; null: it had a start. */
  n_found: number | null;
  seconds: Seconds;
  shape: ((number | null)[])[];
  /** Landmarks that the object lacks. */
  absent: number[];
  covariances: (((number | null)[])[])[];
  /** Standard deviations of the landmarks. */
  deviations: (number | null)[];
  /** null: the fit had a start. */
  found: Found | null;
  /** Whether neither the search nor the fit has found an object: the fit is a guess. */
  nothing_found: boolean;
  /** Boxes of several objects, the one that was fitted first. */
  objects: number[][];
  iterations: Iteration[];
  /** Whether the model was trained on this picture. */
  trained_on: boolean;
  error: FitError | null;
  triangles: number[][];
  contours: Contour[];
  width: number;
  height: number;
  /** Those that can be drawn. */
  layers: string[];
  /** Why its shading cannot be computed. */
  no_flat: string | null;
  /** null: it was fitted alone. */
  specimen: Specimen | null;
  /** Name of the picture, or */
  picture?: string;
  /** id of the dropped one. */
  upload?: string;
}

/** Fits of all specimens of a picture, in reading order. */
interface Fits {
  fits: Fit[];
  /** What is not clear about the picture. */
  faults: string[];
}

/** A dropped picture, which is kept for a while. */
interface Upload {
  id: string;
  name: string;
  width: number;
  height: number;
  /** null: none was asked for, or it failed. */
  fit: Fit | null;
}

/** The colours of a layer, sent beside it. */
interface ColourScale {
  /** The value of the last colour; that of the first is its negative. */
  limit: number;
  what: string;
  /** Of the shading: as LayerChange has it. */
  even?: boolean;
}

/** What the flat picture, or that of corrected colour, changes, sent beside it. */
interface LayerChange {
  /** Whether the light is so much as in training that nothing that can be seen is taken off. */
  even: boolean;
  /** Name of the colour of the light, such as orange; empty: as in training. */
  colour: string;
}

/** The part of the picture that a layer covers, sent beside it. */
interface LayerPlace {
  /** Left, top, width and height, as fractions of the picture's sides. */
  box: number[];
}

/** A distant lamp of a light that is sent. */
interface SentLamp {
  /** x to the right, y down, z to the viewer. */
  direction: number[];
  /** Red, green and blue as on the screen (sRGB), 0 to 1. */
  colour?: number[];
  strength?: number;
  softness?: number;
}

/** The light of a relit picture, which an address holds as JSON. */
interface SentLight {
  lamps: SentLamp[];
  /** Fraction of white ambient light. */
  ambient?: number;
}

/** A video that is tracked while it plays. */
interface LiveVideo {
  id: string;
  /** First line of the table that the rows of its frames make. */
  header: string;
}

/** The landmarks of a picture were saved, by any page. */
interface LandmarksChanged {
  name: string;
  /** null or empty: there is no file any more. */
  revision: string | null;
  /** Changes with what is kept beside the file. */
  beside?: string;
}

/** Something in the folder, or of its models, has changed: the page asks for the project again. */
interface FolderChanged {
}

/** What a refusal may say beside the error. */
interface Details {
  /** The page shows another folder than this one, by its id. */
  folder?: string;
  /** The landmarks, which were changed since the page read them. */
  current?: Marks;
  /** The template, which was changed since the page read it. */
  template?: Template | null;
  /** The training that is running already. */
  training?: Training;
  /** Pictures whose points are only proposed, where accepted ones are needed. */
  proposed?: number;
}

/** The answer to a request that is refused or has failed. */
interface Fault {
  /** The page shows another folder than this one, by its id. */
  folder?: string;
  /** The landmarks, which were changed since the page read them. */
  current?: Marks;
  /** The template, which was changed since the page read it. */
  template?: Template | null;
  /** The training that is running already. */
  training?: Training;
  /** Pictures whose points are only proposed, where accepted ones are needed. */
  proposed?: number;
  /** What is wrong, and what to do, in a sentence for the person. */
  error: string;
}

/** Asks for the project, unless nothing has changed. */
interface ProjectQuery {
  /** Of the project that the page has. */
  stamp?: string | number;
}

/** Asks for a picture or a layer in a size. */
interface ImageQuery {
  /** Longest side in pixels. */
  size?: string | number;
  /** Of the file; with it, the browser keeps the answer. */
  tag?: string | number;
}

/** Asks for a tile of a picture. */
interface TileQuery {
  /** Of the file; with it, the browser keeps the answer. */
  tag?: string | number;
}

/** Asks for the scale of a picture, by what is in it. */
interface ScaleQuery {
  /** ruler or bar. */
  kind?: string | number;
  /** From one smallest tick to the next, or of the bar. */
  length?: string | number;
  unit?: string | number;
}

/** Says what is measured of the pictures, and how. */
interface ShapesQuery {
  /** Such as distance:1-5, with spaces between them. */
  measures?: string | number;
  scale?: string | number;
  /** Groups: folder, name or table. */
  by?: string | number;
  /** Whether missing points are estimated. */
  estimate?: string | number;
  /** Whether a table has the measures only, without coordinates, scores and errors. */
  only?: string | number;
}

/** Says the name of the file that is sent. */
interface FileQuery {
  name?: string | number;
}

/** Says the name of the picture that is sent, and how to fit it. */
interface UploadQuery {
  name?: string | number;
  /** null: it is not fitted. */
  method?: string | number;
}

/** Asks for a layer of a fit in a size. */
interface LayerQuery {
  /** Longest side in pixels. */
  size?: string | number;
  /** 0: the flat picture keeps the colour of its light. */
  balance?: string | number;
}

/** Asks for the object of a fit under another light. */
interface LightQuery {
  /** A SentLight as JSON; null: one lamp beside the camera. */
  light?: string | number;
  size?: string | number;
  /** 0: the picture keeps the colour of its own light. */
  balance?: string | number;
}

/** Asks for a file of a fit. */
interface FitFileQuery {
  what?: string | number;
  /** A SentLight as JSON, for a relit picture. */
  light?: string | number;
  /** Of the changed picture over the picture, 0 to 1; null: 1. */
  opacity?: string | number;
  /** 0: a flat or relit picture keeps the colour of its own light. */
  balance?: string | number;
}

/** Says which fits are in a table. */
interface FitsQuery {
  /** Their ids, with commas between them. */
  fits?: string | number;
}

/** Says what the frame of a video is that is sent. */
interface FrameQuery {
  width: string | number;
  height: string | number;
  /** Width of the video, of which the frame may be a reduced copy. */
  of_width: string | number;
  of_height: string | number;
  number: string | number;
  /** In seconds. */
  time: string | number;
  /** 1: it does not follow the frame before. */
  fresh?: string | number;
  /** 1: its picture without shading is sent back. */
  flat?: string | number;
}

/** Data of the events that the server sends, by kind. */
interface Events {
  project: FolderChanged;
  training: Training;
  fitting: Counted | null;
  landmarks: LandmarksChanged | LandmarksChanged[];
}

/** All routes by their addresses: what varies in these, and what each method takes and answers. */
interface Routes {
  "project": {
    fields: ProjectQuery;
    GET: { answer: Project | Unchanged };
  };
  "events": {
    fields: {};
    GET: { file: Blob };
  };
  "pictures/{name}/image": {
    fields: { name: string | number } & ImageQuery;
    GET: { file: Blob };
  };
  "pictures/{name}/chroma": {
    fields: { name: string | number } & ImageQuery;
    GET: { file: Blob };
  };
  "pictures/{name}/tiles/{level}/{column}/{row}": {
    fields: { name: string | number; level: string | number; column: string | number; row: string | number } & TileQuery;
    GET: { file: Blob };
  };
  "pictures/{name}/landmarks": {
    fields: { name: string | number };
    GET: { answer: Marks };
    PUT: { body: SaveMarks; answer: Saved };
  };
  "pictures/{name}/history": {
    fields: { name: string | number };
    GET: { answer: HistoryEntry[] };
  };
  "pictures/{name}/side": {
    fields: { name: string | number };
    GET: { answer: FoundSide };
  };
  "pictures/{name}/scale": {
    fields: { name: string | number } & ScaleQuery;
    GET: { answer: FoundScale };
  };
  "pictures/{name}/others": {
    fields: { name: string | number };
    GET: { answer: Record<string, (number[] | null)[]> };
  };
  "scale": {
    fields: {};
    GET: { answer: SharedScale };
  };
  "review": {
    fields: {};
    POST: { body: Review; answer: Reviewed };
  };
  "sides": {
    fields: {};
    PUT: { body: SaveSides; answer: SidesBefore };
  };
  "files": {
    fields: FileQuery;
    POST: { body: Blob; answer: Added };
  };
  "removed": {
    fields: {};
    POST: { body: RemovePictures; answer: Removed };
  };
  "restored": {
    fields: {};
    POST: { body: RestorePictures; answer: Removed };
  };
  "renamed": {
    fields: {};
    POST: { body: RenamePicture; answer: Renamed };
  };
  "template": {
    fields: {};
    PUT: { body: SaveTemplate; answer: Template | null };
  };
  "template/file": {
    fields: FileQuery;
    POST: { body: Blob; answer: Template };
  };
  "sets": {
    fields: {};
    POST: { body: MakeSet; answer: MadeSet };
  };
  "agreement": {
    fields: {};
    GET: { answer: Agreement };
  };
  "agreement/model": {
    fields: {};
    GET: { answer: ShapeAgreement };
  };
  "export/{kind}": {
    fields: { kind: string | number };
    GET: { file: Blob };
  };
  "measurements": {
    fields: ShapesQuery;
    GET: { file: Blob };
  };
  "shapes": {
    fields: ShapesQuery;
    GET: { answer: Shapes };
  };
  "groups": {
    fields: {};
    PUT: { body: SaveGroups; answer: Grouped };
  };
  "measuring": {
    fields: {};
    PUT: { body: SaveMeasuring; answer: Measuring };
  };
  "who": {
    fields: {};
    PUT: { body: SaveWho; answer: Who };
  };
  "training": {
    fields: {};
    POST: { body: StartTraining; answer: Training };
    DELETE: { body: StopTraining; answer: Training };
  };
  "model/file": {
    fields: {};
    GET: { file: Blob };
  };
  "model/face": {
    fields: {};
    DELETE: { answer: null };
  };
  "model": {
    fields: {};
    PUT: { body: UseModel; answer: null };
  };
  "model/guest": {
    fields: FileQuery;
    POST: { body: Blob; answer: null };
    DELETE: { answer: null };
  };
  "uploads": {
    fields: UploadQuery;
    POST: { body: Blob; answer: Upload };
  };
  "uploads/{id}/image": {
    fields: { id: string | number } & ImageQuery;
    GET: { file: Blob };
  };
  "uploads/{id}/chroma": {
    fields: { id: string | number } & ImageQuery;
    GET: { file: Blob };
  };
  "uploads/{id}/tiles/{level}/{column}/{row}": {
    fields: { id: string | number; level: string | number; column: string | number; row: string | number } & TileQuery;
    GET: { file: Blob };
  };
  "fits": {
    fields: {};
    POST: { body: FitOne; answer: Fit };
  };
  "fits/all": {
    fields: {};
    POST: { body: FitAll; answer: Fits };
  };
  "fits/table": {
    fields: FitsQuery;
    GET: { file: Blob };
  };
  "fits/{id}/layers/{layer}": {
    fields: { id: string | number; layer: string | number } & LayerQuery;
    GET: { file: Blob };
  };
  "fits/{id}/relit": {
    fields: { id: string | number } & LightQuery;
    GET: { file: Blob };
  };
  "fits/{id}/export": {
    fields: { id: string | number } & FitFileQuery;
    GET: { file: Blob };
  };
  "recordings": {
    fields: {};
    POST: { body: Blob; file: Blob };
  };
  "live": {
    fields: {};
    POST: { answer: LiveVideo };
  };
  "live/{id}/frames": {
    fields: { id: string | number } & FrameQuery;
    POST: { body: Blob; file: Blob };
  };
  "live/{id}": {
    fields: { id: string | number };
    DELETE: { answer: null };
  };
}
