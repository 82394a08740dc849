// The light-invariant image of a picture, computed here so that it follows the theta slider at every frame:
//     L(theta) = cos(theta) log R/B + sin(theta) log G/B.
// The server sends the two logarithms of a picture once, as 16-bit integers; each frame is then two products, a clamp
// and a look-up per pixel. Nothing in this module touches the page.

/** Integer steps of the server's chroma per unit of natural logarithm. */
export const STEPS = 4096;

/** Value of a pixel whose colour cannot be measured (too dark or overexposed). */
export const MASKED = -32768;

/** Least half width of the range shown, so that noise of a grey picture does not fill all of it. */
const LEAST_HALF = 0.02;

/** Pixels that percentiles are taken of: enough for 1 % to stand on forty pixels, few enough to sort in each frame. */
const SAMPLED = 4096;

const SHARE = 0.01;

/**
 * Chroma of a picture from the server's octets: two uint32 (width, height), two float32 (covered: how much of the
 * picture it is of, from the left and upper border, in the picture's pixels), then int16 (height, width, 2).
 * All are little endian, like every machine that runs a browser; typed arrays read them in place. Without the floats,
 * covered is null: all of the picture.
 */
export function parseChroma(buffer) {
  if (buffer.byteLength < 8) throw new RangeError("The picture's chroma is cut short: reload the page.");
  const [width, height] = new Uint32Array(buffer, 0, 2);
  const size = 4 * width * height;
  const [short, expected] = [8 + size, 16 + size];
  if (buffer.byteLength !== expected && buffer.byteLength !== short) {
    throw new RangeError(
      `The picture's chroma has ${buffer.byteLength} octets in place of ${expected}: reload the page.`,
    );
  }
  const covered = buffer.byteLength === short ? null : [...new Float32Array(buffer, 8, 2)];
  return { width, height, covered, values: new Int16Array(buffer, buffer.byteLength - size) };
}

const commonDivisor = (a, b) => (b ? commonDivisor(b, a % b) : a);

/** Evenly spread measurable pixels: the same ones whatever theta, so that the range does not jump between frames. */
export function sampleChroma({ width, values }, limit = SAMPLED) {
  const n = values.length / 2;
  let stride = Math.max(1, Math.floor(n / limit));
  // A stride that shares a factor with the width would look at a few columns only.
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

/** Share of the pixels that can be measured, 0 to 1. */
export function measurable({ values }) {
  let count = 0;
  for (let i = 0; i < values.length; i += 2) if (values[i] !== MASKED) count += 1;
  return values.length ? (2 * count) / values.length : 0;
}

/** Range {centre, half} of the invariant that holds all but the outermost hundredth of the pixels on either side. */
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

/**
 * Range to show while theta is dragged: the contrast stays what it was when the drag began, only its middle follows.
 * So nothing flickers, and an edge that fades does so because the light drops out of it, not by new contrast.
 */
export function steadyRange(sample, theta, held) {
  return { centre: robustRange(sample, theta).centre, half: held.half };
}

/**
 * Colours of the invariant image, written into the 32-bit pixels of an ImageData.
 * Pixels that cannot be measured are hatched, so that they are never taken for dark ones.
 */
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
  [68, 1, 84],
  [72, 40, 120],
  [62, 73, 137],
  [49, 104, 142],
  [38, 130, 142],
  [31, 158, 137],
  [53, 183, 121],
  [110, 206, 88],
  [181, 222, 43],
  [253, 231, 37],
];

/** 256 colours between anchors, as 32-bit pixels. */
export function colourTable(anchors) {
  return Uint32Array.from({ length: 256 }, (_, level) => {
    const at = (level / 255) * (anchors.length - 1);
    const below = Math.min(Math.floor(at), anchors.length - 2);
    const mixed = anchors[below].map((value, k) => Math.round(value + (at - below) * (anchors[below + 1][k] - value)));
    return packed(...mixed);
  });
}

export const COLOURS = {
  grey: colourTable([
    [0, 0, 0],
    [255, 255, 255],
  ]),
  viridis: colourTable(VIRIDIS),
};

/** Angles (degrees) in which the invariant of a real camera lies. */
export const PHYSICAL = [90, 135];

/** Angle that an arrow key asks for, degrees; null for other keys. Shift moves finely. */
export function thetaAfterKey(theta, { key, shiftKey = false }) {
  const step = shiftKey ? 0.1 : 1;
  const moved = {
    ArrowLeft: theta - step,
    ArrowDown: theta - step,
    ArrowRight: theta + step,
    ArrowUp: theta + step,
    PageDown: theta - 10,
    PageUp: theta + 10,
    Home: 0,
    End: 180,
  }[key];
  if (moved === undefined) return null;
  return Math.round(10 * Math.min(180, Math.max(0, moved))) / 10;
}

/** Angle in degrees brought into 0..180, where every invariant is (up to its sign). */
export function foldedTheta(degrees) {
  return ((degrees % 180) + 180) % 180;
}
