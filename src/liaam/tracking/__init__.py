"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from typing import TYPE_CHECKING

from liaam.lazy import submodules
from liaam.tracking.frames import TrackedFrame, TrackStatus
from liaam.tracking.tracker import Tracker, TrackingOptions, track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "track_video"]

if TYPE_CHECKING:
    from liaam.tracking import files as files, shading as shading
else:
    __getattr__ = submodules(__name__, "files", "shading")
