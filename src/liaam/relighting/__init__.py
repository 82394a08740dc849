"""Relighting: the fitted object under the light of training (paper eq 11), or under any other light.

A picture is divided by its light and multiplied with another. ``appearance`` computes the appearance under the training
light, and ``joint`` does so jointly with the light, whose modes are in ``basis``; ``shading`` adds what the modes
leave. ``painting`` warps values from the reference frame to the image, ``extrapolation`` continues them beyond the
mesh, ``lamp`` lights its surface, and ``relighter`` combines them for one fitted image; ``one_call`` fits it too.
"""

from liaam.relighting.appearance import ShadowFree, shadow_free
from liaam.relighting.lamp import Lamp
from liaam.relighting.one_call import relight
from liaam.relighting.painting import paint, without_shading
from liaam.relighting.relighter import Relighter

__all__ = ["Lamp", "Relighter", "ShadowFree", "paint", "relight", "shadow_free", "without_shading"]
