"""The model: shapes, mesh, warp, appearances, the views that combine them, and the model file.

:class:`AAM` is the whole model. A method fits with one :class:`View` of it.
"""

from liaam.model.aam import AAM, load_model
from liaam.model.card import ModelCard
from liaam.model.views import MESH, SURROUNDINGS, VIEWS, Level, Reliability, View

__all__ = ["AAM", "MESH", "SURROUNDINGS", "VIEWS", "Level", "ModelCard", "Reliability", "View", "load_model"]
