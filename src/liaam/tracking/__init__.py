"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.tracking import files, shading
from liaam.tracking.frames import TrackedFrame, TrackStatus
from liaam.tracking.tracker import Tracker, TrackingOptions, track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "files", "shading", "track_video"]
