"""Tracking of an object through a video: prediction, loss and search, and smoothing with the fits' covariances."""

from liaam.tracking import files as files, shading as shading
from liaam.tracking.frames import TrackedFrame as TrackedFrame, TrackStatus as TrackStatus
from liaam.tracking.tracker import Tracker as Tracker, TrackingOptions as TrackingOptions, track_video as track_video
