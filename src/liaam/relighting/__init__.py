"""Relighting: the fitted object under the light of training (paper eq 11), or under any other light.

A picture is divided by its light and multiplied with another. ``appearance`` computes the appearance under the training
light, and ``shading`` does so jointly with the light. ``painting`` warps values from the reference frame to the image,
``extrapolation`` continues them beyond the mesh, ``highlights`` spares what is clipped, ``lamp`` lights the mesh's
surface, and ``relighter`` combines them for one image.
"""

from liaam.relighting.appearance import ShadowFree, shadow_free
from liaam.relighting.lamp import Lamp
from liaam.relighting.light_colour import LightColour
from liaam.relighting.painting import paint, without_shading
from liaam.relighting.relighter import Relighter, relight

__all__ = ["Lamp", "LightColour", "Relighter", "ShadowFree", "paint", "relight", "shadow_free", "without_shading"]
