"""Write tracks to .csv, row by row, or to .npz."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.errors import LiaamError
from liaam.io import atomic_path
from liaam.io.atomic import lock
from liaam.tracking.frames import TrackedFrame

TRACK_SUFFIXES = (".csv", ".npz")  # Suffixes (lower case) of track files

_HEADER = b"frame,time,status"


@dataclass(frozen=True)
class TrackWriter:
    """Takes the frames of a track by its function ``write``."""

    write: Callable[[TrackedFrame], None]


@contextmanager
def track_writer(path: str | os.PathLike[str], n_points: int) -> Iterator[TrackWriter]:
    """Write a track as .csv or .npz, by suffix. The file is created when the block ends without an error.

    Rows of a .csv are written at once to a file beside it that ends in ``.part.csv``, which remains after a crash.

    Parameters
    ----------
    path : path-like
    n_points : int
        Number of landmarks per frame.

    Yields
    ------
    TrackWriter
        Its function ``write`` adds a :class:`TrackedFrame`.
    """
    path = Path(path)
    check_track_name(path)
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".csv":
            with _table(path, temporary, n_points) as table:
                yield table
            return
        frames: list[TrackedFrame] = []
        yield TrackWriter(frames.append)
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays_of(frames, n_points))


def check_track_name(path: Path) -> None:
    """Raise if the suffix is not that of a track file."""
    if path.suffix.lower() not in TRACK_SUFFIXES:
        raise LiaamError(f"{path}: a track's name ends in .csv or .npz, such as {path.stem}.csv")


def is_track(path: Path) -> bool:
    """Return whether a file begins like a track, so that it may be overwritten."""
    with path.open("rb") as file:
        return file.read(len(_HEADER)) == _HEADER if path.suffix.lower() == ".csv" else file.read(2) == b"PK"


def arrays_of(frames: Sequence[TrackedFrame], n_points: int) -> dict[str, np.ndarray]:
    """Return the arrays of a .npz track, with one row per frame."""
    points = (n_points, 2)
    squares = (n_points, 2, 2)
    shapes = dict.fromkeys(("time", "quality", "theta", "roll", "size"), ()) | {"landmarks": points, "raw": points}
    shapes |= {"covariances": squares, "raw_covariances": squares}
    numbers = {
        name: np.array([getattr(frame, name) for frame in frames], np.float64).reshape(len(frames), *shape)
        for name, shape in shapes.items()
    }
    return numbers | {
        "frame": np.array([frame.index for frame in frames], dtype=np.int64),
        "status": np.array([str(frame.status) for frame in frames], dtype=np.str_),
        "fit_status": np.array([str(frame.fit_status or "") for frame in frames], dtype=np.str_),
    }


class TrackRows:
    """Header and rows of a .csv: frame, status, quality, pose, then x, y, fitted x and y, and covariance of landmarks.

    The landmarks are counted from 1.
    """

    def __init__(self, n_points: int) -> None:
        names = ("x{}", "y{}", "raw_x{}", "raw_y{}", "xx{}", "xy{}", "yy{}")
        columns = [name.format(number) for number in range(1, n_points + 1) for name in names]
        facts = ["frame", "time", "status", "fit_status", "quality", "theta_deg"]
        self.header = ",".join([*facts, "roll_deg", "size", "centre_x", "centre_y", *columns]) + "\n"
        self._numbers = ",".join([",".join(["%.3f"] * 4 + ["%.4g"] * 3)] * n_points)
        self._nothing = "," * (len(columns) - 1)

    def of(self, frame: TrackedFrame) -> str:
        """Return the row of a frame, with the end of the line."""
        facts = f"{frame.index},{_number(frame.time, 4)},{frame.status},{frame.fit_status or ''}"
        facts += f",{_number(frame.quality, 4)},{_number(np.rad2deg(frame.theta), 3)}"
        facts += f",{_number(np.rad2deg(frame.roll), 3)}"
        facts += "".join(f",{_number(number, 3)}" for number in (frame.size, *frame.landmarks.mean(axis=0)))
        if not frame.ok:
            return f"{facts},{self._nothing}\n"
        spread = frame.covariances.reshape(-1, 4)[:, [0, 1, 3]]
        numbers = np.concatenate([frame.landmarks, frame.raw, spread], axis=1)
        return f"{facts},{self._numbers % tuple(numbers.ravel().tolist())}\n"


@contextmanager
def _table(path: Path, temporary: Path, n_points: int) -> Iterator[TrackWriter]:
    """Write the rows of a .csv at once."""
    rows = TrackRows(n_points)
    written = False

    def write(frame: TrackedFrame) -> None:
        nonlocal written
        file.write(rows.of(frame))
        file.flush()
        written = True

    part = temporary.with_name(f"{path.stem}.part{path.suffix}")  # on the disk that a link leads to
    with part.open("a", encoding="utf-8", newline="") as file:
        try:
            lock(file.fileno())
        except BlockingIOError:
            raise LiaamError(f"{path} is being written by another process; wait, or give another name") from None
        file.truncate(0)
        file.write(rows.header)
        try:
            yield TrackWriter(write)
        except BaseException:
            if not written:  # nothing to save
                part.unlink()
            raise
    part.replace(temporary)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
