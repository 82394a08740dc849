// The measures of a folder's pictures, in the form that liaam measure takes, such as "distance:1-5", and what they mean.
// The server keeps them with the folder, and lets them follow their points through changes of the template. This module
// draws nothing.

import { distance, mean } from "./points.js";

/** Kinds of measures: label, what it is, points at least and at most, power of the length in the unit, value of the points. */
export const KINDS = {
  distance: { label: "Distance", about: "The straight line between two points", fewest: 2, most: 2, power: 1, of: (points) => lengthOf(points) },
  angle: { label: "Angle", about: "The angle at the second of three points", fewest: 3, most: 3, power: 0, of: (points) => angleOf(points) },
  length: { label: "Length", about: "The way along points, as of a curve", fewest: 2, most: 1000, power: 1, of: (points) => lengthOf(points) },
  area: { label: "Area", about: "What the outline through points encloses", fewest: 3, most: 1000, power: 2, of: (points) => areaOf(points) },
};

/** The measure of points with indices from 0, as liaam measure takes it. */
export const measureOf = (kind, indices) => `${kind}:${indices.map((i) => i + 1).join("-")}`;

/** The kind that so many selected points suggest. */
export const kindFor = (count) => (count === 2 ? "distance" : count === 3 ? "angle" : "area");

/** {kind, indices} of a measure; null if it is written in another way, as with names. */
export function parsed(measure, names) {
  const [kind, points = ""] = measure.split(":");
  const indices = points.split("-").map((number) => Number(number) - 1);
  return kind in KINDS && indices.every((i) => names[i] !== undefined) ? { kind, indices } : null;
}

/** A measure in words, with the names of its points; as it is if it names them in another way. */
export function measureText(measure, names) {
  const known = parsed(measure, names);
  return known ? `${known.kind}: ${known.indices.map((i) => names[i]).join(" – ")}` : measure;
}

/** The indices of the points at the ends of a scale, such as "3-4=0.5 mm"; none of the length of a pixel. @returns {number[]} */
export const endsOf = (scale) => (/^(\d+)-(\d+)=/.exec(scale) ?? []).slice(1).map((number) => Number(number) - 1);

/** What a scale means, as a sentence; "" if there is none. */
export function scaleText(scale, names) {
  if (!scale) return "";
  const ends = endsOf(scale).map((i) => names[i] ?? `${i + 1}`);
  if (ends.length) return `${ends.join(" to ")} is ${scale.split("=")[1].trim()} in every picture. These two points are no part of shapes.`;
  const [, number, unit] = /^(.*?)\s*(?:px|pixels?)\s*\/\s*(.+)$/.exec(scale) ?? [];
  return unit ? `1 ${unit} is ${number} pixels.` : `1 pixel is ${scale}.`;
}

const lengthOf = (points) => points.slice(1).reduce((sum, point, i) => sum + distance(points[i], point), 0);

function angleOf([first, middle, last]) {
  const [a, b] = [first, last].map(([x, y]) => [x - middle[0], y - middle[1]]);
  return (180 / Math.PI) * Math.atan2(Math.abs(a[0] * b[1] - a[1] * b[0]), a[0] * b[0] + a[1] * b[1]);
}

function areaOf(points) {
  const terms = points.map(([x, y], i) => { const [u, v] = points[(i + 1) % points.length]; return x * v - u * y; });
  return Math.abs(terms.reduce((sum, term) => sum + term, 0)) / 2;
}

/** The value of a measure of points, and its unit; null if a point is missing. pixel: {length, unit} or null. */
export function valueOf({ kind, indices }, points, pixel = null) {
  const own = indices.map((i) => points[i]);
  if (own.some((point) => !point)) return null;
  const { power, of } = KINDS[kind];
  const unit = power === 0 ? "°" : `${pixel?.unit ?? "px"}${power === 2 ? "²" : ""}`;
  return { value: of(own) * (pixel?.length ?? 1) ** power, unit };
}

const DIGITS = 4; // significant ones
const isPlainSize = (size) => size === 0 || (size >= 1e-4 && size < 1e6);

/** Decimals with which the largest of some values has four significant digits, so that a column has as many in each row. */
export function decimalsOf(values) {
  const most = Math.max(0, ...values.filter(Number.isFinite).map(Math.abs));
  return most && isPlainSize(most) ? Math.max(0, DIGITS - 1 - Math.floor(Math.log10(most))) : null;
}

/** A number with four significant digits, or with so many decimals, and its unit. @param {number | null} [decimals] */
export function numberText(value, unit = "", decimals = null) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const text = decimals !== null && isPlainSize(Math.abs(value)) ? value.toFixed(decimals)
    : isPlainSize(Math.abs(value)) ? String(Number(value.toPrecision(DIGITS))) : value.toExponential(DIGITS - 1);
  return unit ? `${text}${unit === "°" ? "" : "\u00a0"}${unit}` : text;
}

/** Number, mean, standard deviation and range of the values that are known. */
export function summary(values) {
  const known = values.filter((value) => value !== null);
  if (!known.length) return { n: 0, mean: null, sd: null, least: null, most: null };
  const centre = mean(known);
  const sd = known.length > 1 ? Math.sqrt(known.reduce((sum, v) => sum + (v - centre) ** 2, 0) / (known.length - 1)) : null;
  return { n: known.length, mean: centre, sd, least: Math.min(...known), most: Math.max(...known) };
}

/** The bins of a histogram: {edges, of: the indices of the values in each}; as many as Freedman and Diaconis (1981)
 *  advise, 5 to 40. */
export function bins(values) {
  const known = values.map((value, i) => [value, i]).filter(([value]) => value !== null);
  const sorted = known.map(([value]) => value).sort((a, b) => a - b);
  if (!sorted.length) return { edges: [], of: [] };
  const [least, most] = [sorted[0], sorted.at(-1)];
  const quartile = (q) => sorted[Math.round(q * (sorted.length - 1))];
  const width = (2 * (quartile(0.75) - quartile(0.25))) / Math.cbrt(sorted.length);
  const count = Math.min(40, Math.max(5, Math.ceil((most - least) / (width || Infinity))));
  if (most === least) { // one bar around the only value
    const half = Math.abs(most) / 20 || 0.5;
    return { edges: [most - half, most + half], of: [known.map(([, i]) => i)] };
  }
  const step = (most - least) / count;
  const of = Array.from({ length: count }, () => []);
  for (const [value, i] of known) of[Math.min(count - 1, Math.floor((value - least) / step))].push(i);
  return { edges: Array.from({ length: count + 1 }, (_, i) => least + i * step), of };
}
