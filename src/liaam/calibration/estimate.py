"""An estimated angle, with how far it can be trusted."""

from dataclasses import dataclass, replace

import numpy as np

from liaam.evaluation import angle_difference

PHYSICAL = (float(np.deg2rad(90.0)), float(np.deg2rad(135.0)))
"""Angles of physical cameras, radians (DESIGN section 1)."""

WIDEST_ERROR = float(np.deg2rad(8.0))
"""Standard error beyond which an angle is called unobservable, radians."""


def axis_difference(angle: float, other: float) -> float:
    """Angle minus another, radians in (-pi/2, pi/2]: the angle of a projection has no sign."""
    return 0.5 * angle_difference(2.0 * angle, 2.0 * other)


@dataclass(frozen=True)
class AngleEstimate:
    """An angle of the invariant projection, estimated.

    Attributes
    ----------
    theta : float
        Radians in [0, pi).
    standard_error : float
        Half the width of the 95 % interval over 1.96, radians; infinite where the angle cannot be told.
    message : str
        What made it observable, or what is missing, in a sentence or two.
    light_change : float
        What the angle was seen by: root mean square difference of the lights' colour temperature, as the change of
        log(R / B) it brings about.
    n : int
        Number of surfaces (patches, blocks of pixels) it rests on.
    """

    theta: float
    standard_error: float
    message: str
    light_change: float
    n: int

    @property
    def observable(self) -> bool:
        """Whether the material can tell the angle at all."""
        return bool(np.isfinite(self.standard_error))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, radians; (0, pi) where the angle cannot be told."""
        if not self.observable:
            return 0.0, float(np.pi)
        return self.theta - 1.96 * self.standard_error, self.theta + 1.96 * self.standard_error

    @property
    def physical(self) -> bool:
        """Whether a physical camera can have that angle, given its error."""
        slack = 2.0 * self.standard_error if self.observable else np.pi
        return bool(PHYSICAL[0] - slack <= self.theta <= PHYSICAL[1] + slack)

    def doubted(self) -> "AngleEstimate":
        """Give the same with a word on it if no physical camera can have that angle."""
        if self.physical:
            return self
        return replace(
            self,
            message=f"{self.message}; but no physical camera has this angle (90 to 135 degrees): were the pictures "
            "taken with one white balance and response, and do they show the same surfaces?",
        )
