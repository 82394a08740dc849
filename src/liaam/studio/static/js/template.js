// The landmark template as an immutable value: points, names, paths and symmetry. Every function returns a new draft.
// The twin of a point is its mirrored point.
//
// A draft is {names, points, kinds: "landmark" or "semilandmark", contours: [{indices, closed, name, if it has one}], mirror: twin of each
//  point (itself if none), origins: index of each point in the saved template or null, path: the curve that is being
//  drawn, which clicks continue, or -1, twinPath: its mirror image or -1, layout: see Drafting.layout, if there is one}
// Curves are called contours in files. Without a curve that is being drawn, a click adds a landmark by itself.

import { calledSet, several } from "./annotate-words.js";
import { measureText, parsed } from "./measures.js";
import { axisNormal, bounds, indicesOf, rounded } from "./points.js";

export const EMPTY = Object.freeze(
  { names: [], points: [], kinds: [], contours: [], mirror: [], origins: [], path: -1, twinPath: -1 });

const LANDMARK = "landmark";
const SEMILANDMARK = "semilandmark";

/** Whether a point of a template is a semilandmark, which slides along its curve. */
export const slides = (template, index) => template.kinds?.[index] === SEMILANDMARK;

/** A draft of a saved template with its `points` on the picture, or null for its own layout. @param {Template} template */
export function draftOf(template, points = null) {
  return {
    names: template.names.slice(), points: points ?? template.points ?? template.names.map(() => null),
    kinds: template.kinds?.slice() ?? template.names.map(() => LANDMARK),
    contours: template.contours.map((curve) => ({ ...curve, indices: curve.indices.slice(), closed: Boolean(curve.closed) })),
    mirror: template.mirror?.slice() ?? indicesOf(template.names), origins: indicesOf(template.names), path: -1,
    twinPath: -1,
  };
}

function appended(draft, xy, kind) {
  let number = draft.names.length + 1;
  while (draft.names.includes(`point ${number}`)) number += 1;
  return {
    ...draft, names: [...draft.names, `point ${number}`], points: [...draft.points, rounded(xy)],
    kinds: [...draft.kinds, kind],
    mirror: [...draft.mirror, draft.names.length], origins: [...draft.origins, null],
  };
}

const extend = (contours, path, index) =>
  contours.map((contour, k) => (k === path ? { ...contour, indices: [...contour.indices, index] } : contour));

/** Add a landmark, or a semilandmark to the curve that is being drawn, and, if `axis` (x of a vertical line) is given, its
 *  twin. A point closer to the axis than `tolerance` is placed on it and is its own twin. */
export function addPoint(draft, xy, { axis = null, tolerance = 0 } = {}) {
  const onAxis = axis !== null && Math.abs(xy[0] - axis) <= tolerance;
  const index = draft.names.length;
  const draws = draft.path >= 0;
  const kind = draws ? SEMILANDMARK : LANDMARK;
  let next = appended(draft, onAxis ? [axis, xy[1]] : xy, kind);
  if (draws) next.contours = extend(next.contours, next.path, index);
  if (axis === null) return next;
  if (onAxis) return next.twinPath < 0 ? next : { ...next, contours: extend(next.contours, next.twinPath, index) };
  next = appended(next, [2 * axis - xy[0], xy[1]], kind);
  next.mirror = next.mirror.map((twin, i) => (i === index ? index + 1 : i === index + 1 ? index : twin));
  if (!draws) return next;
  if (next.twinPath >= 0) return { ...next, contours: extend(next.contours, next.twinPath, index + 1) };
  // The mirrored path starts with the twins of the path's points.
  const indices = next.contours[next.path].indices.map((i) => next.mirror[i]);
  return { ...next, contours: [...next.contours, { indices, closed: false }], twinPath: next.contours.length };
}

/** x of the axis of symmetry: half-way between twins, or else in the middle of the points or of the picture. */
export function axisOf({ names, points, mirror }, width) {
  const box = bounds(points);
  const pairs = indicesOf(mirror).filter((i) => mirror[i] > i);
  if (!pairs.length || Math.abs(axisNormal(points, mirror)[0]) < 0.9)
    return box && names.length > 2 ? (box[0] + box[2]) / 2 : (width - 1) / 2;
  return pairs.reduce((sum, i) => sum + (points[i][0] + points[mirror[i]][0]) / 2, 0) / pairs.length;
}

/** Join a path and its mirror image: one path if they meet on the axis, otherwise two. */
export function joined(path, twin, closed) {
  const shares = (i) => path[i] === twin[i];
  const [starts, ends] = [shares(0), shares(path.length - 1)];
  const back = twin.slice(starts ? 1 : 0, ends ? -1 : undefined).reverse();
  if (starts && ends && path.length > 1) return [{ indices: [...path, ...back], closed: true }];
  if (starts && !closed) return [{ indices: [...back, ...path], closed: false }];
  if (ends || (starts && closed)) return [{ indices: [...path, ...back], closed }];
  return [{ indices: path, closed }, { indices: twin, closed }];
}

/** The kinds of points: the ends of curves are landmarks, as is the first point of a closed one, and so are points that
 *  are on no curve. */
function settled(draft, ended = []) {
  const onCurve = new Set(draft.contours.flatMap(({ indices }) => indices));
  const ends = new Set(ended.flatMap(({ indices, closed }) => (closed ? [indices[0]] : [indices[0], indices.at(-1)])));
  return { ...draft, kinds: draft.kinds.map((kind, i) => (onCurve.has(i) && !ends.has(i) ? kind : LANDMARK)) };
}

/** Begin to draw a curve: the next clicks add its points. */
export function startPath(draft) {
  const ended = newPath(draft);
  return { ...ended, contours: [...ended.contours, { indices: [], closed: false }], path: ended.contours.length };
}

/** End the curve that is being drawn; the next click adds a landmark by itself. */
export function newPath(draft, closed = false) {
  if (draft.path < 0) return draft;
  const { indices, ...curve } = draft.contours[draft.path];
  const twin = draft.twinPath < 0 ? null : draft.contours[draft.twinPath].indices;
  const [own, ...others] = twin ? joined(indices, twin, closed) : [{ indices, closed: closed && indices.length > 2 }];
  const done = [{ ...curve, ...own }, ...others]; // a mirror image has no name
  const contours = draft.contours.flatMap((contour, k) =>
    k === draft.path ? done : k === draft.twinPath ? [] : contour);
  const whole = { ...draft, contours: contours.filter((contour) => contour.indices.length > 1), path: -1, twinPath: -1 };
  return settled(whole, done.filter((contour) => contour.indices.length > 1));
}

export function continuePath(draft, path) {
  const ended = newPath(draft);
  const contour = draft.contours[path];
  const at = ended.contours.findIndex((other) => other.indices === contour?.indices);
  return at < 0 ? ended : { ...setClosed(ended, at, false), path: at };
}

/** Connect the current path to an existing point; a path contains a point once. */
export function connect(draft, index) {
  const { path, contours } = draft;
  if (contours[path]?.indices.includes(index)) return draft;
  if (path >= 0) return { ...draft, contours: extend(contours, path, index) };
  return { ...draft, contours: [...contours, { indices: [index], closed: false }], path: contours.length };
}

export const setClosed = (draft, path, closed) =>
  ({ ...draft, contours: draft.contours.map((c, k) => (k === path ? { ...c, closed } : c)) });

export const nameCurve = (draft, path, name) =>
  ({ ...draft, contours: draft.contours.map((curve, k) => (k === path ? { ...curve, name } : curve)) });

/** The name of a curve, or else its number. */
export const curveText = ({ name = "" }, k) => name.trim() || `Curve ${k + 1}`;

export const removePath = (draft, path) =>
  settled({ ...draft, path: -1, twinPath: -1, contours: draft.contours.filter((_, k) => k !== path) });

/** Make a landmark a semilandmark, or the other way round. A point on no curve stays a landmark. */
export const changeKind = (draft, index) => settled({
  ...draft,
  kinds: draft.kinds.map((kind, i) => (i === index ? (kind === LANDMARK ? SEMILANDMARK : LANDMARK) : kind)),
});

export const rename = (draft, index, name) =>
  ({ ...draft, names: draft.names.map((old, i) => (i === index ? name : old)) });

/** The draft with reordered points: order[new index] = old index; other points are deleted. */
function arranged(draft, order) {
  const now = new Map(order.map((old, i) => [old, i]));
  const pick = (list) => order.map((old) => list[old]);
  const kept = draft.contours.map((curve) => {
    const left = curve.indices.filter((i) => now.has(i)).map((i) => now.get(i));
    return { ...curve, indices: left, closed: curve.closed && left.length > 2 };
  });
  // The curve that is being drawn may have no point yet; all others need two.
  const alive = kept.map((contour, k) => k === draft.path || k === draft.twinPath || contour.indices.length > 1);
  const newPlace = (k) => (k < 0 || !alive[k] ? -1 : alive.slice(0, k).filter(Boolean).length);
  return settled({
    ...draft, names: pick(draft.names), points: pick(draft.points), kinds: pick(draft.kinds), origins: pick(draft.origins),
    mirror: order.map((old, i) => now.get(draft.mirror[old]) ?? i), contours: kept.filter((_, k) => alive[k]),
    path: newPlace(draft.path), twinPath: newPlace(draft.twinPath), layout: order.length ? draft.layout : null,
  });
}

export function deletePoints(draft, indices) {
  const gone = new Set(indices);
  return arranged(draft, indicesOf(draft.names).filter((i) => !gone.has(i)));
}

export function reorder(draft, from, to) {
  const order = indicesOf(draft.names);
  const [moved] = order.splice(from, 1);
  order.splice(Math.min(Math.max(to, 0), order.length), 0, moved);
  return arranged(draft, order);
}

const repeated = (names) => names.find((name, i) => names.indexOf(name) !== i);

/** What is wrong with a draft; null if it can be saved. */
export function fault(draft) {
  if (draft.names.length < 3)
    return `A template needs at least three points: add ${3 - draft.names.length} more.`;
  const blank = draft.names.findIndex((name) => !name.trim());
  if (blank >= 0) return `Point ${blank + 1} has no name: enter one.`;
  const duplicate = repeated(draft.names.map((name) => name.trim()));
  if (duplicate !== undefined) return `Two points have the name '${duplicate}': rename one.`;
  const curves = draft.contours.map(({ name = "" }) => name.trim()).filter(Boolean);
  const twice = repeated(curves.map((name) => name.toLowerCase()));
  if (twice !== undefined) return `Two curves have the name '${curves.find((name) => name.toLowerCase() === twice)}': rename one.`;
  const lost = draft.points.findIndex((point) => !point);
  if (lost >= 0) return `'${draft.names[lost]}' is not placed: click its position on the picture, or delete it.`;
  return null;
}

/** The template of a draft, as JSON for the server.
 *  @returns {Pick<SaveTemplate, "names" | "points" | "kinds" | "contours" | "mirror">} */
export function templateOf(draft) {
  const { names, points, kinds, contours, mirror } = newPath(draft);
  return {
    names: names.map((name) => name.trim()), points, kinds,
    contours: contours.map(({ indices, closed, name = "" }) => ({ indices, closed, ...(name.trim() && { name: name.trim() }) })),
    mirror: mirror.some((twin, i) => twin !== i) ? mirror : null,
  };
}

/** The draft with the semilandmarks of a sliders file, as of geomorph: rows of the numbers of the point before, of the one
 *  that slides, and of the point after. Null if the text is none, or names points that the draft does not have. */
export function withSliders(draft, text) {
  const rows = text.trim().split(/\r?\n/).map((line) => line.split(/[\s,;]+/).map((cell) => cell.replaceAll('"', "")));
  const numbers = rows.map((row) => row.slice(-3).map(Number));
  const sliders = Number.isNaN(numbers[0][1]) ? numbers.slice(1) : numbers; // without a heading
  const isPoint = (number) => Number.isInteger(number) && number > 0 && number <= draft.names.length;
  const isOne = (row) => new Set(row).size === 3 && row.every(isPoint);
  if (!sliders.length || !sliders.every(isOne)) return null;
  const sliding = new Set(sliders.map(([, point]) => point - 1));
  const kept = newPath(draft).contours.filter(({ indices }) => !indices.some((i) => sliding.has(i)));
  const kinds = draft.names.map((_, i) => (sliding.has(i) ? SEMILANDMARK : LANDMARK));
  return { ...draft, kinds, contours: [...kept, ...curvesOf(sliders)], path: -1, twinPath: -1 };
}

/** The curves through sliders, which are [before, point, after] counted from 1. */
function curvesOf(sliders) {
  const waiting = sliders.map((row) => row.map((number) => number - 1));
  const curves = [];
  while (waiting.length) {
    const indices = waiting.shift();
    const follows = ([before, point]) => before === indices.at(-2) && point === indices.at(-1);
    const precedes = ([, point, after]) => point === indices[0] && after === indices[1];
    const findNext = () => waiting.findIndex((row) => follows(row) || precedes(row));
    for (let at = findNext(); at >= 0; at = findNext()) {
      const [row] = waiting.splice(at, 1);
      if (follows(row)) indices.push(row[2]);
      else indices.unshift(row[0]);
    }
    const length = new Set(indices).size; // a closed curve repeats its first point, or its first two if all slide
    curves.push({ indices: indices.slice(0, length), closed: indices.length > length });
  }
  return curves;
}

/** Old index of each point of the current template, null for a new one, by names. If names only changed in place,
 *  points are matched by position. */
export function mappingByNames(before, now) {
  const was = now.map((name) => before.indexOf(name));
  const stays = (old, i) => old === i || (old < 0 && !now.includes(before[i]));
  const renamed = before.length === now.length && was.every(stays);
  return was.map((old, i) => (renamed ? i : old < 0 ? null : old));
}

/** Convert marks of another template to the current one.
 *  content: {points, invisible, bar}; before: names of its template, or null if unknown; now: names of the current one;
 *  current: the picture's marks on the server, used for new points.
 *  Returns {content, lost: names of placed points that the current template lacks}; content is null if the names are
 *  unknown. */
export function carried(content, before, now, current, mapping = null) {
  if (!before && !mapping) return { content: null, lost: content.points.map((_, i) => `point ${i + 1}`) };
  const origins = mapping ?? mappingByNames(before, now);
  const hidden = new Set(content.invisible);
  const known = new Set(current.invisible);
  const points = origins.map((old, i) => (old === null ? (current.points[i] ?? null) : (content.points[old] ?? null)));
  const isHidden = (old, i) => (old === null ? known.has(i) : hidden.has(old));
  const invisible = indicesOf(points).filter((i) => points[i] && isHidden(origins[i], i));
  const whence = () => origins.map((old, i) => (old === null ? current.origins?.[i] : content.origins[old]) ?? null);
  const lacks = ({ absent }, i) => (absent?.includes(i) ?? false);
  const absent = indicesOf(points).filter((i) => !points[i] && (
    origins[i] === null ? lacks(current, i) : lacks(content, origins[i])));
  const more = { ...(content.absent && { absent }), ...(content.origins && { origins: whence() }) };
  const kept = new Set(origins);
  const gone = indicesOf(content.points).filter((i) => content.points[i] && !kept.has(i));
  return { content: { points, invisible, bar: content.bar ?? null, ...more }, lost: gone.map((i) => before?.[i] ?? `point ${i + 1}`) };
}

/** Convert a draft of the template `before` (null: none) to a draft of `now`. */
export function rebased(draft, before, now) {
  const moved = before ? mappingByNames(before.names, now.names) : [];
  const origins = draft.origins.map((origin, i) => {
    const at = origin === null ? now.names.indexOf(draft.names[i]) : moved.indexOf(origin);
    return at < 0 ? null : at;
  });
  return { ...draft, origins: origins.map((origin, i) => (origins.indexOf(origin) === i ? origin : null)) };
}

export const rearranges = (draft, count) =>
  draft.origins.length !== count || draft.origins.some((origin, i) => origin !== i);

export function changes(draft, count) {
  const kept = draft.origins.filter((origin) => origin !== null);
  const [added, deleted] = [draft.origins.length - kept.length, count - kept.length];
  const moved = kept.some((origin, i) => i > 0 && origin < kept[i - 1]);
  return [
    deleted > 0 && `${several(deleted, "point")} will be deleted`,
    added > 0 && `${several(added, "point")} will be added, and will be missing in the other pictures`,
    moved && "the order of the points will change",
  ].filter(Boolean);
}

/** The measures that lose a point by a change of the template with these names, in words. */
function lostMeasures(draft, names, { measures, names: called = {} }) {
  const isLost = (measure) => parsed(measure, names)?.indices.some((i) => !draft.origins.includes(i));
  return measures.filter(isLost).map((measure) => called[measure] ?? measureText(measure, names));
}

/** The sets of other observers, which keep their points as they are, in words; "" if they stay comparable. */
function othersKeep(draft, names, { observers, set }) {
  const isSame = draft.names.length === names.length && draft.names.every((name, i) => name === names[i]);
  const others = observers.filter((name) => name !== set).map(calledSet);
  if (isSame || !others.length) return "";
  const [keep, their] = others.length === 1 ? ["keeps", "its"] : ["keep", "their"];
  return `${others.join(" and ")} ${keep} ${their} points as they are, and so cannot be compared with this set any more.`;
}

/** What a change of the points, or of their names, does to the folder, to be confirmed; "" if nothing is lost.
 *  names: before the change. @param {any} draft; @param {string[]} names; @param {Pick<Project, "pictures" | "model" | "measuring" | "observers" | "set">} project */
export function consequences(draft, names, project) {
  const others = othersKeep(draft, names, project);
  const count = names.length;
  if (!rearranges(draft, count)) return others;
  const { pictures, model, measuring } = project;
  const lost = lostMeasures(draft, names, measuring);
  const files = pictures.filter(({ placed, state }) => state === "reading" || (placed > 0 && state !== "proposed")).length;
  const checks = pictures.filter(({ checked }) => checked).length;
  const copy = model?.source === "studio" ? " A copy of the model stays in .liaam-studio/kept." : "";
  return [
    files && `The landmark files of ${several(files, "picture")} will be rewritten: ${changes(draft, count).join("; ")}.`,
    model?.source === "studio" && `The trained model and its proposed points will be removed.${copy}`,
    checks && `The checks of ${several(checks, "picture")} will be withdrawn.`,
    lost.length > 0 && `${several(lost.length, "measure")} will be removed: ${lost.join("; ")}.`,
    others,
  ].filter(Boolean).join(" ");
}
