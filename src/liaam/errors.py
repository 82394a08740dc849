"""Errors for invalid input. Each message names the file or argument, the fault and the remedy.

All are also the built-in errors that other libraries would raise: :exc:`ValueError`, :exc:`FileNotFoundError` where a
file is missing, and :exc:`TypeError` for a misspelt keyword. A failed fit does not raise. It returns a
:class:`liaam.fitting.FitResult` with a ``status``.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence

__all__ = [
    "CameraError",
    "ImageError",
    "LandmarkError",
    "LiaamError",
    "MethodError",
    "MissingCameraError",
    "MissingFileError",
    "MissingImageError",
    "MissingLandmarksError",
    "MissingModelError",
    "MissingVideoError",
    "ModelFileError",
    "OptionError",
    "StartError",
    "TrainingError",
    "VideoError",
]


def __dir__() -> list[str]:
    return __all__


def installing(extra: str) -> str:
    """Return the command that installs an optional dependency, for messages."""
    return f'pip install ".[{extra}]" in a checkout of liaam'


# Largest number of characters of a message. Values of files are part of messages, and a file may hold megabytes.
LONGEST_MESSAGE = 2000
# Largest number of characters of a value of a file within a message
LONGEST_VALUE = 200


def shortened(text: object, longest: int = LONGEST_VALUE) -> str:
    """Return a text without its middle if it is longer than so many characters: begin and end say most."""
    text = str(text)
    if len(text) <= longest:
        return text
    mark = " ... "
    n_end = (longest - len(mark)) // 3
    return text[: longest - len(mark) - n_end] + mark + text[len(text) - n_end :]


class LiaamError(ValueError):
    """Base class of every error that liaam raises on purpose.

    A message has at most 2000 characters; a longer one loses its middle.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        # Set here, because the base classes of MissingFileError do not call each other.
        self.args = tuple(shortened(each, LONGEST_MESSAGE) if isinstance(each, str) else each for each in args)


class MissingFileError(FileNotFoundError, LiaamError):
    """A file or folder does not exist."""

    __init__ = LiaamError.__init__


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


class MissingImageError(ImageError, MissingFileError):
    """An image does not exist."""


class MissingLandmarksError(LandmarkError, MissingFileError):
    """A landmark file does not exist."""


class MissingModelError(ModelFileError, MissingFileError):
    """A model file does not exist."""


class MissingCameraError(CameraError, MissingFileError):
    """A camera file, or one to calibrate a camera from, does not exist."""


class MissingVideoError(VideoError, MissingFileError):
    """A video does not exist."""


class OptionError(LiaamError, TypeError):
    """A keyword is unknown."""


def missing(error: type[LiaamError]) -> type[LiaamError]:
    """Return the kind of an error that is raised where a file does not exist."""
    if error is LiaamError:
        return MissingFileError
    return next((each for each in error.__subclasses__() if issubclass(each, MissingFileError)), error)


_SYNONYMS = {
    "start": "init",
    "initial": "init",
    "initialization": "init",
    "shape": "init",
    "bbox": "init",
    "box": "init",
}
"""Arguments that people expect by another name, as users have tried them."""


def check_options(given: Iterable[str], allowed: Sequence[str], remedies: Mapping[str, str] | None = None) -> None:
    """Raise for the first given option that is not known, and suggest a known one, or its remedy if there is one."""
    for name in given:
        if name in allowed:
            continue
        close = difflib.get_close_matches(name, allowed, n=1)
        meant = _SYNONYMS.get(name) or (close[0] if close else "")
        remedy = (remedies or {}).get(name) or (f"did you mean {meant!r}?" if meant else "")
        listed = f"unknown option {name!r}; choose from {', '.join(allowed)}"
        raise OptionError(f"{listed}; {remedy}" if remedy else listed)


class CoreWarning(RuntimeWarning, UserWarning):
    """The compiled core is missing, so that fits take longer, or is older than its sources."""
