"""The sides of the objects of a model, such as left and right wings, and reflections of images and points."""

from dataclasses import dataclass

import numpy as np

from liaam.io.sides import MIRRORED, ORIGINAL, OTHER_SIDE

OTHER = OTHER_SIDE | {ORIGINAL: MIRRORED, MIRRORED: ORIGINAL}
"""The other side of each."""


@dataclass(frozen=True)
class Sides:
    """The sides of training images.

    Attributes
    ----------
    own : str
        The side of the model, to which the images of the other were reflected: ``left`` or ``right``, or ``original``
        if sides were not stated.
    n_own, n_other : int
        Number of training images of each side.
    """

    own: str
    n_own: int = 0
    n_other: int = 0

    def __post_init__(self) -> None:
        """Check that the side is one."""
        if self.own not in OTHER:
            raise ValueError(f"side {self.own!r} is none of {', '.join(OTHER)}")

    @property
    def other(self) -> str:
        """The other side."""
        return OTHER[self.own]

    def of(self, reflected: bool) -> str:
        """Return the side of an object that is fitted as it is, or reflected."""
        return self.other if reflected else self.own

    def describe(self) -> str:
        """Describe the sides of the training images, and what is done about them."""
        tried = f"fits try both sides, and state whether an object is {self.own} or {self.other}"
        if not self.n_other:
            return f"the training images are {self.own}, and {tried}"
        images = f"{self.n_own} {self.own} and {self.n_other} {self.other} training images"
        return f"{images}; the {self.other} ones are reflected; {tried}"


def reflected_image(image: np.ndarray) -> np.ndarray:
    """Reverse an image (h, w, ...) left to right."""
    return np.ascontiguousarray(image[:, ::-1])


def reflected_points(points: np.ndarray, width: int) -> np.ndarray:
    """Return points (..., 2) where they are in an image of a width once it is reversed left to right."""
    return np.asarray(points) * [-1.0, 1.0] + [width - 1.0, 0.0]


def reflected_covariances(covariances: np.ndarray) -> np.ndarray:
    """Return covariances (..., 2, 2) of points once x is reversed."""
    return np.asarray(covariances) * np.array([[1.0, -1.0], [-1.0, 1.0]])
