"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.lazy import submodules
from liaam.tracking.tracker import TrackedFrame, Tracker, TrackingOptions, TrackStatus, track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "track_video"]

__getattr__ = submodules(__name__, "files", "shading")
