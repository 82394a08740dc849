"""Overlays of fits on images, and figures of models, lamps, cameras and videos."""

from liaam.plotting import photometry as photometry, video as video
from liaam.plotting.figures import (
    figure_of_fits as figure_of_fits,
    figure_of_lamps as figure_of_lamps,
    figure_of_model as figure_of_model,
    figure_of_pictures as figure_of_pictures,
    save_figure as save_figure,
    show_picture as show_picture,
    subplots as subplots,
)
from liaam.plotting.overlays import (
    enlarged as enlarged,
    overlay as overlay,
    overlay_of_faults as overlay_of_faults,
)
