// The light-invariant image of a picture, computed in the browser so that each frame follows the theta slider:
//     L(theta) = cos(theta) log R/B + sin(theta) log G/B.
// The server sends the two logarithms once, as 16-bit integers. Each frame takes two products, a clamp and a look-up
// per pixel. This module is independent of the page.

export const STEPS = 4096; // integer steps of the server's chroma per unit of natural logarithm
export const MASKED = -32768; // value of an unusable pixel (too dark or overexposed)
const LEAST_HALF = 0.02; // half width of the displayed range, so that it is not filled by the noise of a grey picture
const SAMPLED = 4096; // pixels for percentiles: 1 % of them are forty pixels, and they can be sorted in each frame
const SHARE = 0.01;

/** Chroma of a picture from the server's bytes, little-endian: two uint32 (width, height), two float32 (covered width
 *  and height of the picture from its upper left, in its pixels), then int16 (height, width, 2). */
export function parseChroma(buffer) {
  const found = buffer.byteLength;
  if (found < 16) throw new RangeError("The picture's chroma is incomplete: reload the page.");
  const [width, height] = new Uint32Array(buffer, 0, 2);
  const expected = 16 + 4 * width * height;
  if (found !== expected)
    throw new RangeError(`The picture's chroma has ${found} bytes instead of ${expected}: reload the page.`);
  return { width, height, covered: [...new Float32Array(buffer, 8, 2)], values: new Int16Array(buffer, 16) };
}

const commonDivisor = (a, b) => (b ? commonDivisor(b, a % b) : a);

/** Evenly spaced usable pixels, the same for every theta, so that the range does not jump between frames. */
export function sampleChroma({ width, values }, limit = SAMPLED) {
  const n = values.length / 2;
  let stride = Math.max(1, Math.floor(n / limit));
  // A stride with a common factor with the width would sample a few columns only.
  while (commonDivisor(width, stride) > 1) stride += 1;
  const red = [];
  const green = [];
  for (let i = 0; i < n; i += stride) {
    if (values[2 * i] === MASKED) continue;
    red.push(values[2 * i] / STEPS);
    green.push(values[2 * i + 1] / STEPS);
  }
  return { red: Float32Array.from(red), green: Float32Array.from(green) };
}

export function measurable({ values }) {
  let count = 0;
  for (let i = 0; i < values.length; i += 2) if (values[i] !== MASKED) count += 1;
  return values.length ? (2 * count) / values.length : 0;
}

/** Range {centre, half} of the invariant between the 1st and 99th percentile of the pixels. */
export function robustRange({ red, green }, theta) {
  const n = red.length;
  if (!n) return { centre: 0, half: 1 };
  const [c, s] = [Math.cos(theta), Math.sin(theta)];
  const projected = new Float32Array(n);
  for (let i = 0; i < n; i += 1) projected[i] = c * red[i] + s * green[i];
  projected.sort();
  const low = projected[Math.floor(SHARE * (n - 1))];
  const high = projected[Math.ceil((1 - SHARE) * (n - 1))];
  return { centre: (low + high) / 2, half: Math.max((high - low) / 2, LEAST_HALF) };
}

/** Range while theta is dragged: the contrast stays as at the start of the drag, and only the centre follows. So
 *  nothing flickers, and an edge fades because the light cancels, not because the contrast changes. */
export const steadyRange = (sample, theta, held) => ({ centre: robustRange(sample, theta).centre, half: held.half });

/** Write the colours of the invariant image into the 32-bit pixels of an ImageData. Unusable pixels are hatched, to
 *  distinguish them from dark ones. */
export function paintInvariant({ width, height, values }, theta, { centre, half }, colours, out) {
  const gain = 128 / (half * STEPS);
  const c = Math.cos(theta) * gain;
  const s = Math.sin(theta) * gain;
  const shift = 128 - (128 * centre) / half;
  let i = 0;
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1, i += 1) {
      const red = values[2 * i];
      if (red === MASKED) {
        out[i] = (x + y) & 4 ? HATCH_LIGHT : HATCH_DARK;
        continue;
      }
      const level = c * red + s * values[2 * i + 1] + shift;
      out[i] = colours[level < 0 ? 0 : level > 255 ? 255 : level | 0];
    }
  }
}

const packed = (r, g, b) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
const HATCH_DARK = packed(52, 50, 58);
const HATCH_LIGHT = packed(84, 80, 94);

/** Anchors of viridis (Smith and van der Walt, CC0), evenly spaced. */
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 73, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121],
  [110, 206, 88], [181, 222, 43], [253, 231, 37],
];

function colourTable(anchors) {
  return Uint32Array.from({ length: 256 }, (_, level) => {
    const at = (level / 255) * (anchors.length - 1);
    const below = Math.min(Math.floor(at), anchors.length - 2);
    const mixed = anchors[below].map((value, k) => Math.round(value + (at - below) * (anchors[below + 1][k] - value)));
    return packed(...mixed);
  });
}

export const COLOURS = { grey: colourTable([[0, 0, 0], [255, 255, 255]]), viridis: colourTable(VIRIDIS) };
export const PHYSICAL = [90, 135]; // the angles of real cameras, degrees

/** Angle after an arrow key, degrees; null for other keys. Shift moves in small steps. */
export function thetaAfterKey(theta, { key, shiftKey = false }) {
  const step = shiftKey ? 0.1 : 1;
  const moved = {
    ArrowLeft: theta - step, ArrowDown: theta - step, ArrowRight: theta + step, ArrowUp: theta + step,
    PageDown: theta - 10, PageUp: theta + 10, Home: 0, End: 180,
  }[key];
  if (moved === undefined) return null;
  return Math.round(10 * Math.min(180, Math.max(0, moved))) / 10;
}

/** Angle in degrees, folded into 0..180, which covers every invariant up to its sign. */
export const foldedTheta = (degrees) => ((degrees % 180) + 180) % 180;
