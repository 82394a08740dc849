// The object under lamps, computed in the browser while they are moved: Lambert's law on the server's normals, as in
// relighting/relighter.py. What is left out there is small: noise, and light beyond white.

const DARKEST = 0.02; // least light
const LONGEST = 1.5; // largest exposure
const GAMMA = 2.2;
const INSIDE = 250; // share of light, of 255, from which a pixel counts as the object's
const LONGEST_SIDE = 800; // pixels

/** Light of a lamp from the cosine between normal and lamp. */
const lit = (facing, softness) =>
  Math.abs(facing) < softness ? (facing + softness) ** 2 / (4 * softness) : Math.max(facing, 0);

const pixelsOf = (image) => {
  const ctx = new OffscreenCanvas(image.width, image.height).getContext("2d");
  ctx.drawImage(image, 0, 0);
  return ctx.getImageData(0, 0, image.width, image.height);
};

export class RoughLight {
  /** flat: the picture without shading; normals: their x and y in red and green, the share of light in blue; box: [left,
   *  top, width, height] of these in the picture, as fractions. */
  constructor(flat, normals, box) {
    const factor = Math.min(1, LONGEST_SIDE / Math.max(flat.width, flat.height));
    const [width, height] = [flat.width, flat.height].map((side) => Math.round(factor * side));
    this.canvas = Object.assign(document.createElement("canvas"), { width, height });
    this._flat = new OffscreenCanvas(width, height);
    this._flat.getContext("2d").drawImage(flat, 0, 0, width, height);
    this._box = box.map((side, i) => side * [width, height][i % 2]);
    this._darker = pixelsOf(normals); // factors below 1, by which the picture is multiplied
    this._brighter = pixelsOf(normals); // 1 - 1 / factor of those above 1, with which it is dodged
    this._layer = new OffscreenCanvas(normals.width, normals.height);
    const { data } = pixelsOf(normals);
    this._n = data.length / 4;
    const part = (of) => Float32Array.from({ length: this._n }, (_, i) => of(data.subarray(4 * i)));
    this._x = part(([red]) => (red - 128) / 127);
    this._y = part(([, green]) => (green - 128) / 127);
    this._z = this._x.map((x, i) => Math.sqrt(Math.max(1 - x * x - this._y[i] ** 2, 0)));
    this._share = part(([, , blue]) => blue / 255);
    this._light = new Float32Array(3 * this._n);
    this._frontal = new Float32Array(this._n);
  }

  /** Paint the object under lights. @param {{ambient: number, lamps: {direction: number[], channels: number[],
   *  softness: number}[]}} lights channels: stored red, green and blue, times the strength in light */
  draw({ lamps, ambient }) {
    const ctx = this.canvas.getContext("2d");
    this._compute(lamps, ambient);
    ctx.globalCompositeOperation = "copy";
    ctx.drawImage(this._flat, 0, 0);
    this._blend(ctx, "multiply", this._darker);
    this._blend(ctx, "color-dodge", this._brighter);
  }

  /** @param {GlobalCompositeOperation} how */
  _blend(ctx, how, factors) {
    this._layer.getContext("2d").putImageData(factors, 0, 0);
    ctx.globalCompositeOperation = how;
    ctx.drawImage(this._layer, ...this._box);
  }

  _compute(lamps, ambient) {
    const { _n: n, _x: x, _y: y, _z: z, _share: share, _light: light, _frontal: frontal } = this;
    const [darker, brighter, sums] = [this._darker.data, this._brighter.data, { frontal: 0, light: 0 }];
    for (let i = 0; i < n; i += 1) {
      frontal[i] = Math.max(ambient + (1 - ambient) * z[i], DARKEST);
      for (let c = 0; c < 3; c += 1) light[3 * i + c] = ambient;
      for (const { direction: [u, v, w], channels, softness } of lamps) {
        const from = (1 - ambient) * lit(u * x[i] + v * y[i] + w * z[i], softness);
        for (let c = 0; c < 3; c += 1) light[3 * i + c] += from * channels[c];
      }
      for (let c = 0; c < 3; c += 1) light[3 * i + c] = Math.max(light[3 * i + c], DARKEST);
      if (share[i] < INSIDE / 255) continue;
      sums.frontal += frontal[i];
      sums.light += (light[3 * i] + light[3 * i + 1] + light[3 * i + 2]) / 3;
    }
    const exposure = Math.min(Math.sqrt(sums.frontal / Math.max(sums.light, 1e-6)), LONGEST);
    for (let i = 0; i < n; i += 1)
      for (let c = 0; c < 3; c += 1) {
        const factor = share[i] ? ((exposure * light[3 * i + c]) / frontal[i]) ** (share[i] / GAMMA) : 1;
        darker[4 * i + c] = 255 * Math.min(factor, 1);
        brighter[4 * i + c] = 255 * (1 - 1 / Math.max(factor, 1));
      }
  }
}
