"""Landmarks in the scheme of another set, placed along the contours of a model's landmarks."""

from collections.abc import Sequence

import numpy as np

from liaam.errors import LiaamError
from liaam.morphometry.curves import resample

_JAW = "jaw_{0}_1 jaw_{0}_2 jaw_{0}_3 jaw_{0}_4 jaw_{0}_5 jaw_{0}_6 jaw_{0}_7 chin"
_BROW = "{0}_brow_outer {0}_brow_top_1 {0}_brow_top_2 {0}_brow_top_3 {0}_brow_top_4 {0}_brow_inner"
_NOSTRIL = "nose_wing_{0}_3 nostril_{0}_outer nostril_{0}_inner nose_base"
_LID = "{0}_eye_outer {0}_eye_{1}_1 {0}_eye_{1}_2 {0}_eye_{1}_3 {0}_eye_inner"
_UPPER = "mouth_{0} upper_lip_{0}_1 upper_lip_{0}_2 upper_lip_top"
_LOWER = "mouth_{0} lower_lip_{0}_1 lower_lip_{0}_2 "
_INNER = "mouth_{0} {1}_lip_inner_{0}_1 {1}_lip_inner_{0}_2 {1}_lip_{2}"


def _line(text: str, *words: str) -> list[str]:
    return text.format(*words).split()


# Schemes by name. In turn: the names of landmarks along a line, the number of points at even distances on it with both
# ends, and which of these are landmarks of the scheme. {} stands for the middle between right and left.
SCHEMES = {
    "ibug-68": (
        (_line(_JAW, "right"), 9, slice(None)),
        (_line(_JAW, "left")[::-1], 9, slice(1, None)),
        (_line(_BROW, "right"), 5, slice(None)),
        (_line(_BROW, "left")[::-1], 5, slice(None)),
        (["nose_ridge_{}_1", "nose_ridge_{}_2", "nose_ridge_{}_3"], 4, slice(None)),
        (_line(_NOSTRIL, "right"), 3, slice(None)),
        (_line(_NOSTRIL, "left")[::-1], 3, slice(1, None)),
        (_line(_LID, "right", "top"), 4, slice(None)),
        (_line(_LID, "right", "bottom")[::-1], 4, slice(1, -1)),
        (_line(_LID, "left", "top")[::-1], 4, slice(None)),
        (_line(_LID, "left", "bottom"), 4, slice(1, -1)),
        (_line(_UPPER, "right"), 4, slice(None)),
        (_line(_UPPER, "left")[::-1], 4, slice(1, None)),
        (_line(_LOWER + "lower_lip_bottom", "left"), 4, slice(1, None)),
        (_line(_LOWER + "lower_lip_bottom", "right")[::-1], 4, slice(1, -1)),
        (_line(_INNER, "right", "upper", "bottom"), 6, slice(1, None, 2)),  # the corners lie inside those of the mouth
        (_line(_INNER, "left", "upper", "bottom")[::-1], 6, slice(2, None, 2)),
        (_line(_INNER, "left", "lower", "top"), 6, slice(3, None, 2)),
        (_line(_INNER, "right", "lower", "top")[::-1], 6, slice(2, 3)),
    ),
}


def in_scheme(points: np.ndarray, names: Sequence[str], scheme: str) -> np.ndarray:
    """Place the landmarks of a scheme, (m, 2) float64, along lines through the landmarks of a face, (n, 2).

    The names are those of the face model that comes with liaam. The scheme ``ibug-68`` has the 68 landmarks of iBUG's
    300-W.
    """
    if scheme not in SCHEMES:
        raise LiaamError(f"scheme {scheme!r} is unknown; choose from {', '.join(SCHEMES)}")
    place_of = dict(zip(names, np.asarray(points, np.float64), strict=False))

    def place(name: str) -> np.ndarray:
        sides = list(dict.fromkeys(name.format(side) for side in ("right", "left")))
        if lacking := next((side for side in sides if side not in place_of), None):
            raise LiaamError(
                f"scheme {scheme}: it needs landmarks with the names of the face model that comes with liaam, and "
                f"{lacking} is missing; use that model, or leave the scheme out"
            )
        return np.mean([place_of[side] for side in sides], axis=0)

    lines = SCHEMES[scheme]
    return np.concatenate([resample(np.array([*map(place, line)]), n)[which] for line, n, which in lines])
