"""Errors raised for bad input: each names the thing, the fault and the remedy.

A fit that fails is a value (:class:`liaam.fitting.FitResult` with a ``status``), not an exception.
"""


class LiaamError(Exception):
    """Base class of every error that liaam raises on purpose."""


class ImageError(LiaamError):
    """An image cannot be read, or cannot serve the purpose (grey for a colour method, too small ...)."""


class LandmarkError(LiaamError):
    """A landmark file cannot be read, or its points do not fit the image or each other."""


class TrainingError(LiaamError):
    """A model cannot be trained from these samples."""


class ModelFileError(LiaamError):
    """A model file is missing, cut short, of another version, or not a liaam model."""


class StartError(LiaamError):
    """The start of a fit (shape, box, or point and size) makes no sense for this model and image."""


class MethodError(LiaamError):
    """A method, encoding or option of that name does not exist or cannot be used here."""


class CameraError(LiaamError):
    """A camera file cannot be read or written, or a camera cannot be calibrated from this material."""


class VideoError(LiaamError):
    """A video or camera cannot be read, or a video cannot be written."""
