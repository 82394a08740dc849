"""Overlays of fits on images, and figures of models, lamps, cameras and videos."""

from liaam.plotting import photometry, video
from liaam.plotting.figures import (
    figure_of_fits,
    figure_of_lamps,
    figure_of_model,
    figure_of_pictures,
    save_figure,
    show_picture,
    subplots,
)
from liaam.plotting.overlays import enlarged, overlay, overlay_of_faults, overlay_of_fit, thumbnail

__all__ = [
    "enlarged",
    "figure_of_fits",
    "figure_of_lamps",
    "figure_of_model",
    "figure_of_pictures",
    "overlay",
    "overlay_of_faults",
    "overlay_of_fit",
    "photometry",
    "save_figure",
    "show_picture",
    "subplots",
    "thumbnail",
    "video",
]
