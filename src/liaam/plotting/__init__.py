"""Overlays of fits on images, and figures of models, lamps, cameras and videos."""

from liaam.plotting import photometry as photometry, video as video
from liaam.plotting.figures import (
    figure_of_fits,
    figure_of_lamps,
    figure_of_model,
    figure_of_pictures,
    save_figure,
    show_picture,
    subplots,
)
from liaam.plotting.overlays import enlarged, mesh_edges, overlay, overlay_of_faults

__all__ = [
    "enlarged",
    "figure_of_fits",
    "figure_of_lamps",
    "figure_of_model",
    "figure_of_pictures",
    "mesh_edges",
    "overlay",
    "overlay_of_faults",
    "save_figure",
    "show_picture",
    "subplots",
]
