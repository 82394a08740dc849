"""Reflectance of a person's skin and skull on the chart, computed once per identity.

Colours are linear RGB reflectances, 0 to 1; `scenes.light` turns them into spectra.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator

from scenes import chart
from scenes.chart import Face, smoothstep
from scenes.head import Head, Traits
from scenes.surface import face_of

TEXELS_PER_UNIT = 220
CHART = (-1.45, 1.45, -1.34, 1.16)  # u and v ranges of the textures
NOISE_SIZE = 256

FAIR, MIDDLE, DEEP = (0.74, 0.46, 0.365), (0.47, 0.245, 0.155), (0.155, 0.080, 0.052)
BLOOD = np.array([0.10, 0.62, 0.52])
"""Decrease of the log-reflectance by a unit of blood under the skin."""
MELANIN = np.array([0.30, 0.55, 0.80])


@dataclass(frozen=True)
class Textures:
    """Reflectances of a person."""

    skin: np.ndarray
    """(h, w, 4) float32 on the skin's chart: colour, and opening (0 to 1) to the skull below."""
    skull: np.ndarray
    """(h, w, 3) float32 on the skull's chart: eyes and mouth."""
    weave: np.ndarray
    """(256, 256) float32 periodic texture of cloth, mean 0."""
    strands: np.ndarray
    """(256, 256) float32 periodic texture of hair, mean 0."""


@lru_cache(maxsize=16)
def textures_of(head: Head) -> Textures:
    """Paint a person (cached)."""
    face = face_of(head)
    rng = np.random.default_rng([head.seed, 0x5C11])
    canvas = _Canvas.of(face, rng)
    colour = skin_tone(face.traits.skin) * np.exp(_complexion(canvas))
    colour = _paint_nostrils(canvas, _paint_lips(canvas, colour))
    colour = _paint_brows(canvas, _paint_lids(canvas, colour))
    strands, weave = _periodic(rng, (0.6, 26)), _periodic(rng, (1.2, 1.2))
    colour = _paint_hair(canvas, colour)
    skin = np.dstack([np.clip(colour, 0.004, 0.95), _openings(canvas)]).astype(np.float32)
    return Textures(skin, _paint_skull(canvas), weave, strands)


def look_up(texture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Sample a chart's texture at coordinates (h, w), bilinear; the border's colour continues outside."""
    column = ((u - CHART[0]) * TEXELS_PER_UNIT).astype(np.float32)
    row = ((CHART[3] - v) * TEXELS_PER_UNIT).astype(np.float32)
    return cv2.remap(texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def look_up_periodic(texture: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sample a periodic texture at (a, b), one period per unit."""
    at = [np.mod(c * NOISE_SIZE, NOISE_SIZE).astype(np.float32) for c in (a, b)]
    return cv2.remap(texture, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def skin_tone(depth: float) -> np.ndarray:
    """Reflectance (3,) of skin from fair (0) to deep (1)."""
    logs = np.log([FAIR, MIDDLE, DEEP])
    return np.exp([np.interp(depth, [0, 0.55, 1], logs[:, k]) for k in range(3)])


@dataclass(frozen=True)
class _Canvas:
    """The chart's coordinates at every texel, and the identity's random generator."""

    face: Face
    rng: np.random.Generator
    u: np.ndarray
    v: np.ndarray
    x: np.ndarray

    @classmethod
    def of(cls, face: Face, rng: np.random.Generator) -> "_Canvas":
        u0, u1, v0, v1 = CHART
        u, v = np.meshgrid(
            np.arange(u0, u1, 1 / TEXELS_PER_UNIT, dtype=np.float32),
            np.arange(v1, v0, -1 / TEXELS_PER_UNIT, dtype=np.float32),
        )
        return cls(face, rng, u, v, chart.u_to_frontal(u, v, face.profile).astype(np.float32))

    @property
    def traits(self) -> Traits:
        return self.face.traits

    def bump(self, x: float, v: float, sx: float, sv: float, both: bool = True) -> np.ndarray:
        """A soft spot, mirrored to both sides of the face."""
        across = np.abs(self.x) if both else self.x
        return np.exp(-(((across - x) / sx) ** 2) - ((self.v - v) / sv) ** 2)

    def noise(self, sigma_u: float, sigma_v: float | None = None) -> np.ndarray:
        """Smooth Gaussian noise of unit variance; correlation lengths in head units."""
        sigma_v = sigma_u if sigma_v is None else sigma_v
        shape = self.u.shape
        # Noise that is smooth over many texels is drawn at a lower resolution and enlarged, which is much faster.
        step = max(1, int(min(sigma_u, sigma_v) * TEXELS_PER_UNIT / 3))
        small = self.rng.standard_normal((shape[0] // step + 2, shape[1] // step + 2)).astype(np.float32)
        across, down = (max(sigma * TEXELS_PER_UNIT / step, 0.3) for sigma in (sigma_u, sigma_v))
        small = cv2.GaussianBlur(small, (0, 0), across, sigmaY=down)
        noise = cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC)
        return noise / noise.std()


def _complexion(c: _Canvas) -> np.ndarray:
    """Log-reflectance (h, w, 3) of bare skin relative to its mean tone."""
    t, y_mouth, base = c.traits, c.traits.mouth_y, -c.traits.nose_length
    blood = 0.40 * c.bump(0.40, -0.33, 0.16, 0.14) + 0.38 * c.bump(0.0, base + 0.06, 0.10, 0.08)
    blood += 0.25 * c.bump(t.nose_width, base + 0.04, 0.05, 0.05) + 0.14 * c.bump(
        0.0, c.face.landmarks[6, 1] + 0.1, 0.13, 0.1
    )
    blood += 0.10 * c.bump(t.eye_x, 0.1, 0.13, 0.05) + 0.10 * c.bump(0.0, 0.40, 0.3, 0.12)
    blood = (
        t.redness * (1 - 0.5 * t.skin) * blood + 0.09 * c.noise(0.10) + 0.05 * c.noise(0.03) + 0.035 * c.noise(0.008)
    )
    melanin = 0.10 * c.bump(t.eye_x - 0.03, -0.11, 0.12, 0.045) + 0.08 * c.bump(t.eye_x, 0.10, 0.12, 0.05)
    melanin += 0.06 * c.noise(0.16) + 0.03 * c.noise(0.012) + _freckles(c) + _moles(c)
    log = -blood[..., None] * BLOOD - melanin[..., None] * MELANIN
    log += (0.05 * c.bump(0.0, 0.38, 0.35, 0.2) + 0.025 * c.noise(0.005))[..., None]
    if t.stubble > 0:
        log -= (_stubble(c, y_mouth) * t.stubble)[..., None] * np.array([0.62, 0.52, 0.40])
    return log


def _freckles(c: _Canvas) -> np.ndarray:
    where = c.bump(0.30, -0.25, 0.24, 0.13) + c.bump(0.0, -0.22, 0.12, 0.14) + 0.35
    spots = smoothstep((c.noise(0.009) - 1.15) / 0.7)
    return 0.55 * c.traits.freckles * where * spots


def _moles(c: _Canvas) -> np.ndarray:
    """A few moles away from the features."""
    total = np.zeros_like(c.u)
    for _ in range(c.rng.integers(1, 5)):
        x, v = c.rng.choice([-1, 1]) * c.rng.uniform(0.36, 0.55), c.rng.uniform(-0.70, -0.15)
        total += c.rng.uniform(0.5, 1.4) * c.bump(x, v, *[c.rng.uniform(0.010, 0.016)] * 2, both=False)
    return total


def _stubble(c: _Canvas, y_mouth: float) -> np.ndarray:
    x = np.abs(c.x)
    beard = smoothstep((y_mouth + 0.08 + 1.1 * np.maximum(x - 0.20, 0) - c.v) / 0.16) * smoothstep((0.72 - x) / 0.15)
    moustache = c.bump(0.10, y_mouth + 0.105, 0.15, 0.045)
    hairs = 1 + 0.35 * c.noise(0.006, 0.009) + 0.2 * c.noise(0.05)
    return np.maximum(beard, moustache) * np.clip(hairs, 0.2, 2)


def _paint_lips(c: _Canvas, colour: np.ndarray) -> np.ndarray:
    face, half = c.face, c.face.landmarks[43, 0]
    x = np.clip(c.x, -0.998 * half, 0.998 * half)
    upper, upper_in, lower_in, lower = (f(x) for f in chart.lip_curves(face))
    inside = np.minimum(np.minimum(upper - c.v, c.v - lower), (half - np.abs(c.x)) * 0.5)
    lips = smoothstep(0.5 + inside / 0.026)
    wrinkles = 0.10 * c.noise(0.006, 0.03)
    depth = (1.05 if c.traits.hair_style == "long" else 0.62) + 0.20 * (c.v > 0.5 * (upper_in + lower_in)) + wrinkles
    tone = colour * np.exp(-depth[..., None] * (BLOOD * 1.10 + 0.13))
    colour = colour + lips[..., None] * (tone - colour)
    # The line between the lips stays dark when they close.
    line = np.minimum(np.abs(c.v - upper_in), np.abs(c.v - lower_in))
    line = np.exp(-((line / 0.012) ** 2)) * smoothstep((half - np.abs(c.x)) / 0.05)
    return colour * np.exp(-line[..., None] * np.array([0.75, 1.0, 0.95]))


def _paint_nostrils(c: _Canvas, colour: np.ndarray) -> np.ndarray:
    t = c.traits
    x, base = np.abs(c.x), -t.nose_length
    holes = np.exp(
        -((((x - 0.46 * t.nose_width) / 0.034) ** 2 + ((c.v - base - 0.004 + 0.1 * (x - 0.08)) / 0.017) ** 2) ** 2)
    )
    crease = np.exp(-(((np.hypot((x - 0.70 * t.nose_width) / 0.95, c.v - base - 0.05) - 0.062) / 0.012) ** 2))
    crease *= smoothstep((x - 0.86 * t.nose_width) / 0.04)
    dark = 1.3 * holes + 0.40 * crease
    return colour * np.exp(-dark[..., None] * np.array([0.85, 1.1, 1.15]))


def _paint_lids(c: _Canvas, colour: np.ndarray) -> np.ndarray:
    """Lashes, the crease of the upper lid and the pink edge of the lower one."""
    x = np.abs(c.x)
    upper, lower = chart.eye_curves(c.face)
    inner, outer = c.face.landmarks[[17, 13], 0]
    inside = np.clip(x, inner, outer)
    ends = smoothstep((x - inner + 0.012) / 0.03) * smoothstep((outer + 0.030 - x) / 0.03)
    flick = 0.35 * np.maximum(x - outer, 0)
    heavy = 1.25 if c.traits.hair_style == "long" else 0.9
    lash = np.exp(-(((c.v - upper(inside) - 0.003 - flick) / 0.011) ** 2)) * ends * heavy
    lash += 0.35 * np.exp(-(((c.v - lower(inside) + 0.004) / 0.008) ** 2)) * ends
    crease = np.exp(-(((c.v - upper(inside) - 0.030) / 0.010) ** 2)) * ends
    dark = 1.7 * lash + 0.42 * crease
    return colour * np.exp(-dark[..., None] * np.array([0.95, 1.05, 1.05]))


def _paint_brows(c: _Canvas, colour: np.ndarray) -> np.ndarray:
    t = c.traits
    curve = c.face.landmarks[list(chart.BROW_RIGHT)]
    along = (np.abs(c.x) - curve[0, 0]) / (curve[-1, 0] - curve[0, 0])
    centre = PchipInterpolator(*curve.T)(np.clip(np.abs(c.x), curve[0, 0], curve[-1, 0]))
    half = t.brow_thickness * np.clip(1.1 - 0.75 * np.clip(along, 0, 1) ** 1.5, 0.3, None)
    across = (c.v - centre + 0.25 * half) / half
    hairs = _slanted_noise(c)
    density = smoothstep(1.5 - np.abs(across) + 0.15 * hairs) * smoothstep((along + 0.05) / 0.10)
    density *= smoothstep((1.06 - along) / 0.10) * np.clip(0.84 + 0.12 * hairs, 0, 1)
    hair = np.array(t.hair_colour) * 0.9 + 0.012
    return colour + density[..., None] * (np.minimum(hair, 0.8 * colour) - colour)


def _slanted_noise(c: _Canvas) -> np.ndarray:
    """Noise of unit variance smeared along slanted strokes, mirrored at the mid-line."""
    size = 15
    kernel = np.zeros((size, size), np.float32)
    cv2.line(kernel, (1, size - 5), (size - 2, 4), 1.0, 1, cv2.LINE_AA)
    noise = cv2.filter2D(c.noise(0.004), -1, kernel / kernel.sum())
    noise = np.where(c.x > 0, noise, noise[:, ::-1])
    return noise / noise.std()


def _paint_hair(c: _Canvas, colour: np.ndarray) -> np.ndarray:
    """Hair: short and brushed up, or long and swept to both sides of a parting."""
    short = c.traits.hair_style == "short"
    strands = c.noise(0.006, 0.035) if short else _swept_noise(c)
    frayed = 0.020 * strands + 0.012 * c.noise(0.03) if short else 0.006 * strands
    inside = chart.hair_depth(c.face, c.u, c.v, ragged=frayed)
    hair = np.array(c.traits.hair_colour) * np.exp(0.24 * strands + 0.16 * c.noise(0.03, 0.15))[..., None]
    cover = smoothstep((inside + 0.015) / (0.10 if short else 0.05))[..., None]
    parting = 0.0 if short else 0.35 * np.exp(-(((c.x - chart.PARTING) / 0.010) ** 2))
    hair = hair + (parting * cover[..., 0])[..., None] * (colour - hair)
    shade = np.exp(-0.22 * np.exp(-np.abs(inside) / 0.05))[..., None]
    return (colour + cover * (hair - colour)) * shade


def _swept_noise(c: _Canvas) -> np.ndarray:
    """Noise of unit variance smeared along the parabolas in which hair falls from a parting."""
    noise = _periodic(c.rng, (1.0, 22))
    away = np.abs(c.u - chart.PARTING)
    swept = look_up_periodic(noise, 0.9 * (c.v + 1.3 * away**2) + 0.4 * (c.u > chart.PARTING), 0.5 * away)
    return swept / swept.std()


def _openings(c: _Canvas) -> np.ndarray:
    """Mask of the openings of the skin at the eyes and the mouth."""
    eyes = chart.eye_opening(c.face, np.abs(c.x), c.v, soft=0.006)
    half = c.face.landmarks[43, 0]
    _, upper, lower, _ = (f(np.clip(c.x, -0.998 * half, 0.998 * half)) for f in chart.lip_curves(c.face))
    mouth = smoothstep(0.5 + np.minimum(upper - c.v, c.v - lower) / 0.010) * (np.abs(c.x) < half)
    return np.maximum(eyes, mouth * smoothstep((upper - lower) / 0.012))


def _paint_skull(c: _Canvas) -> np.ndarray:
    """Eyeballs above, teeth and tongue below."""
    skull = np.where((c.v > -0.3)[..., None], _eyes(c), _mouth(c))
    return np.clip(skull, 0.012, 0.9).astype(np.float32)


def _eyes(c: _Canvas) -> np.ndarray:
    t = c.traits
    dx, dv = c.x - np.sign(c.x) * (t.eye_x - 0.002), c.v - 0.012
    r = np.hypot(dx, dv) * 0.90
    white = (
        np.array([0.52, 0.475, 0.45]) * np.exp(-0.8 * np.clip(np.abs(dx) / t.eye_half_width, 0, 1.2) ** 4)[..., None]
    )
    # The upper lid shades the eyeball even in even light.
    white = white * (1 - 0.35 * smoothstep((dv - 0.005) / 0.05))[..., None]
    rays = 1 + 0.25 * np.sin(23 * np.arctan2(dv, dx) + 3 * c.noise(0.01)) * smoothstep((r - 0.02) / 0.03)
    ring = 1 - 0.65 * smoothstep((r - 0.046) / 0.013)
    iris = np.array(t.iris_colour) * (rays * ring * (1.15 - 0.5 * smoothstep((dv + 0.02) / 0.06)))[..., None]
    eye = white + smoothstep((0.064 - r) / 0.010)[..., None] * (iris - white)
    eye = eye + smoothstep((0.030 - r) / 0.008)[..., None] * (0.022 - eye)
    glint = np.exp(-(((c.x - np.sign(c.x) * t.eye_x + 0.018) / 0.009) ** 2) - ((dv - 0.022) / 0.009) ** 2)
    return eye + glint[..., None] * (0.75 - eye)


def _mouth(c: _Canvas) -> np.ndarray:
    t = c.traits
    cavity = np.broadcast_to(np.array([0.085, 0.030, 0.028]), (*c.u.shape, 3)).copy()
    tongue = smoothstep((t.mouth_y - 0.115 - 1.5 * c.x**2 - c.v) / 0.05)[..., None]
    cavity += tongue * (np.array([0.24, 0.085, 0.08]) - cavity)
    edge = t.mouth_y - 0.062 + 0.35 * c.x**2 + 0.004 * np.cos(2 * np.pi * c.x / 0.078)
    gap = 1 - 0.45 * np.exp(-((np.abs((c.x / 0.078 + 0.5) % 1.0 - 0.5) / 0.07) ** 2))
    teeth = np.array([0.66, 0.60, 0.50]) * (gap * np.exp(-12 * c.x**2))[..., None]
    show = smoothstep((c.v - edge) / 0.012)[..., None]
    return cavity + show * (teeth - cavity)


def _periodic(rng: np.random.Generator, sigma: tuple[float, float]) -> np.ndarray:
    """Periodic noise of unit variance with blurs ``sigma`` (columns, rows) in texels."""
    frequency = np.fft.fftfreq(NOISE_SIZE)
    gain = np.exp(-2 * np.pi**2 * ((sigma[0] * frequency[None]) ** 2 + (sigma[1] * frequency[:, None]) ** 2))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((NOISE_SIZE, NOISE_SIZE))) * gain).real
    return ((noise - noise.mean()) / noise.std()).astype(np.float32)
