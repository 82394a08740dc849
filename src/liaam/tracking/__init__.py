"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.tracking import files as files, shading as shading
from liaam.tracking.frames import TrackedFrame, TrackStatus
from liaam.tracking.tracker import Tracker, TrackingOptions, track_video

__all__ = ["TrackStatus", "TrackedFrame", "Tracker", "TrackingOptions", "track_video"]
