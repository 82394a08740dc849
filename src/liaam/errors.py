"""Errors for invalid input. Each message names the file or argument, the fault and the remedy.

A failed fit does not raise. It returns a :class:`liaam.fitting.FitResult` with a ``status``.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence


def installing(extra: str) -> str:
    """Return the command that installs an optional dependency, for messages."""
    return f'pip install ".[{extra}]" in a checkout of liaam'


class LiaamError(Exception):
    """Base class of every error that liaam raises on purpose."""


class ImageError(LiaamError):
    """An image cannot be read or used, for example because it is too small or grey for a colour method."""


class LandmarkError(LiaamError):
    """A landmark file cannot be read, or its points do not match the image or each other."""


class TrainingError(LiaamError):
    """A model cannot be trained from these samples."""


class ModelFileError(LiaamError):
    """A model file is missing, cut short, from another version, or not a liaam model."""


class StartError(LiaamError):
    """The start of a fit (shape, box, or point and size) is invalid for this model and image."""


class MethodError(LiaamError):
    """A method, encoding or option does not exist or cannot be used here."""


class CameraError(LiaamError):
    """A camera file cannot be read or written, or a camera cannot be calibrated from these data."""


class VideoError(LiaamError):
    """A video or camera cannot be read, or a video cannot be written."""


def check_options(
    given: Iterable[str], known: Sequence[str], error: type[LiaamError], remedies: Mapping[str, str] | None = None
) -> None:
    """Raise `error` for the first given option that is not known, and suggest a known one.

    Parameters
    ----------
    given, known : names of options
    error : type of LiaamError
    remedies : mapping of str to str, optional
        Remedies for some unknown names.
    """
    for name in given:
        if name in known:
            continue
        close = difflib.get_close_matches(name, known, n=1)
        remedy = (remedies or {}).get(name) or (f"did you mean {close[0]!r}?" if close else "")
        listed = f"unknown option {name!r}; choose from {', '.join(known)}"
        raise error(f"{listed}; {remedy}" if remedy else listed)
