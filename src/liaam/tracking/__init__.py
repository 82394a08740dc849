"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.tracking.tracker import TrackedFrame, Tracker, TrackingOptions, TrackStatus, track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "track_video"]
