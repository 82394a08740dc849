"""Relighting: the fitted object under the light of training (paper eq 11), or under a light of one's choice.

``appearance`` rebuilds what the object looks like under the training light, ``together`` does so with the shading told
at the same time; ``painting`` lays values of the reference frame over a picture, and ``beyond`` goes
on outside of the mesh, without a seam (by ``carrying``);
``shading`` parts a picture into shading and what is under it; ``relief`` makes a surface up for lights that no picture
has; ``relighter`` does all of it for one fitted picture.
"""

from liaam.relighting.appearance import ShadowFree, shadow_free
from liaam.relighting.painting import paint, without_shading
from liaam.relighting.relighter import Relighter

__all__ = ["Relighter", "ShadowFree", "paint", "shadow_free", "without_shading"]
