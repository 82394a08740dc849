"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.tracking.tracker import TrackedFrame, Tracker, TrackingOptions, TrackStatus
from liaam.tracking.video import track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "track_video"]
