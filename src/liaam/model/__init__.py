"""The model: shapes, mesh, warp, appearances, the views made of them, and the file that holds all.

:class:`AAM` is the whole; a :class:`View` of it is what a method fits with.
"""

from liaam.model.aam import AAM, load_model
from liaam.model.views import MESH, SURROUNDINGS, VIEWS, Level, Reliability, View, make_view

__all__ = ["AAM", "MESH", "SURROUNDINGS", "VIEWS", "Level", "Reliability", "View", "load_model", "make_view"]
