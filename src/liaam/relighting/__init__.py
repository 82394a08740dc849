"""Relighting: the fitted object under the light of training (paper eq 11), or under any other light.

``appearance`` computes the appearance under the training light, and ``joint`` does so jointly with the shading.
``painting`` warps values from the reference frame to an image; ``extrapolation`` extends them beyond the mesh by
``domain_transform``. ``shading`` separates an image into shading and appearance. ``relief`` makes a surface for new
lights, ``lamp`` lights it, and ``relighter`` combines them for one fitted image; ``one_call`` fits it too.
"""

from liaam.relighting.appearance import ShadowFree, shadow_free
from liaam.relighting.lamp import Lamp
from liaam.relighting.one_call import relight
from liaam.relighting.painting import paint, without_shading
from liaam.relighting.relighter import Relighter

__all__ = ["Lamp", "Relighter", "ShadowFree", "paint", "relight", "shadow_free", "without_shading"]
