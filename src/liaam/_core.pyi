"""Types of the compiled core, and of the functions of the same names in NumPy."""

from typing import Any

import numpy as np

INSTRUCTION_SETS: tuple[str, ...]
INSTRUCTION_SET: str
BUILT: bool
TIMES_SLOWER: int

def stored_means(
    image: np.ndarray, table: np.ndarray, x: float, y: float, size: float, rows: int, columns: int
) -> np.ndarray: ...
def stored_brightness(
    image: np.ndarray, tables: np.ndarray, x: float, y: float, size: float, rows: int, columns: int
) -> np.ndarray: ...
def value_means(values: np.ndarray, x: float, y: float, size: float, rows: int, columns: int) -> np.ndarray: ...
def area_means(image: np.ndarray, rows: int, columns: int) -> np.ndarray: ...
def stored_luminance(image: np.ndarray, tables: np.ndarray) -> np.ndarray: ...
def has_equal_channels(image: np.ndarray) -> bool: ...
def encode(
    light: np.ndarray,
    finite: np.ndarray | None,
    grey: bool,
    encoding: int,
    floor: float,
    blur: float,
    turn: tuple[float, ...],
    pixel: float,
) -> np.ndarray: ...
def blur_planes(planes: np.ndarray, sigma: float) -> np.ndarray: ...
def soft_directions(plane: np.ndarray, turn: tuple[float, ...], softness: float) -> np.ndarray: ...
def sample_channels(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...
def count_orientations(
    brightness: np.ndarray, finite: np.ndarray | None, blur: float, turn: tuple[float, ...], pixel: float
) -> np.ndarray: ...
def blurred_at(counts: np.ndarray, points: np.ndarray, sigma: float) -> np.ndarray: ...
def correlate(image: np.ndarray, templates: np.ndarray, product: np.ndarray) -> None: ...
def best_peaks(image: np.ndarray, count: int, least: float, reach: int) -> tuple[np.ndarray, np.ndarray]: ...
def draw_triangles(
    points: np.ndarray, triangles: np.ndarray, values: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]: ...
def mean_field(
    own: np.ndarray, sampled: np.ndarray, taps: np.ndarray, strength: float, rounds: int
) -> tuple[np.ndarray, np.ndarray]: ...
def filter_rows_and_columns(layers: np.ndarray, across: np.ndarray, down: np.ndarray) -> None: ...
def spline_slopes(values: np.ndarray, order: np.ndarray, joined: np.ndarray) -> np.ndarray: ...

# The rest is in the compiled core only.

class Objective: ...
class EncodedImage: ...

class Solution:
    p: np.ndarray
    angles: tuple[float, float]
    lam: np.ndarray
    costs: np.ndarray
    path: np.ndarray
    angle_history: np.ndarray
    n_iterations: int
    converged: bool
    angle_fixed: bool
    no_texture: bool
    noise_variance: float
    squares: float
    weight: float
    prior_scale: float
    n_counted: int
    expected_hessian: np.ndarray
    usable: np.ndarray
    samples: np.ndarray
    residual: np.ndarray
    contrast: np.ndarray
    weighted_contrast: np.ndarray

class FittedLevel:
    fit: Solution
    pose: np.ndarray
    to_patch: np.ndarray
    patch_size: tuple[int, int]

class PreparedFit:
    def fit(
        self, image: np.ndarray, table: np.ndarray, grey: bool, floor: float, target: dict, options: dict
    ) -> list[FittedLevel]: ...
    def fit_light(
        self, light: np.ndarray, finite: np.ndarray | None, grey: bool, floor: float, target: dict, options: dict
    ) -> list[FittedLevel]: ...

class Problem:
    def __init__(self, objective: Objective, image: EncodedImage) -> None: ...
    def begin(self, p: np.ndarray, angles: tuple[float, float], lam: np.ndarray) -> None: ...
    def set_state(self, p: np.ndarray, angles: tuple[float, float], lam: np.ndarray) -> None: ...
    def evaluate(self, solves: bool) -> None: ...
    def reweigh(self, solves: bool) -> bool: ...
    def differentiate(self, image_in_j: bool, image_in_e: bool) -> None: ...
    def arrays(self) -> dict[str, Any]: ...

def make_objective(fields: dict) -> Objective: ...
def make_image(fields: dict) -> EncodedImage: ...
def weighted_gram(codes: np.ndarray, scales: np.ndarray, m: int, sqrt_weights: np.ndarray) -> np.ndarray: ...
def prepare(fields: dict) -> PreparedFit: ...
def solve_level(
    objective: Objective,
    image: EncodedImage,
    p: np.ndarray,
    angles: tuple[float, ...],
    lam: np.ndarray,
    options: dict,
    blur: float,
    evaluate_last: bool,
) -> Solution: ...
