"""Results as tables: columns by name, which pandas takes and :func:`liaam.io.write_columns` writes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError, installing

if TYPE_CHECKING:
    import pandas

Columns = dict[str, list]
"""Columns by name, of one length."""


def landmark_columns(
    labels: Mapping[str, Any],
    points: np.ndarray,
    covariances: np.ndarray | None = None,
    names: Sequence[str] = (),
    **more: Any,
) -> Columns:
    """Return a table with one row per landmark of an image.

    Its columns are `labels` (one value each, such as the image), ``landmark`` (from 1), ``name`` (empty if unknown),
    ``x``, ``y``, ``sd`` (pixels, from the mean variance of x and y; NaN if unknown), and `more`, as `labels`.
    """
    n = len(points)
    spread = np.full((n, 2, 2), np.nan) if covariances is None else np.asarray(covariances)
    return {
        **{key: [value] * n for key, value in labels.items()},
        "landmark": list(range(1, n + 1)),
        "name": list(names) if len(names) == n else [""] * n,
        "x": points[:, 0].tolist(),
        "y": points[:, 1].tolist(),
        "sd": np.sqrt(0.5 * np.trace(spread, axis1=1, axis2=2)).tolist(),
        **{key: [value] * n for key, value in more.items()},
    }


def to_dataframe(results: Any, names: Iterable[str] | None = None, absent: str = "empty") -> "pandas.DataFrame":
    """Convert results to a pandas data frame with one row per landmark.

    Parameters
    ----------
    results : FitResult, TrackedFrame or Specimen, or iterable of these, or Evaluation, or dict
        Also the list of :func:`liaam.fit_many` with ``errors="return"``. A dictionary is a table of
        :func:`liaam.measure`, which has one row per specimen.
    names : iterable of str, optional
        Name of each result, instead of the image's file name or ``image 1``, ``image 2``, ...
    absent : {"empty", "estimate"}
        What stands for absent landmarks of fits (:attr:`liaam.FitResult.absent`): NaN, or the estimates.

    Returns
    -------
    pandas.DataFrame
        For fits the columns ``image``, ``landmark`` (from 1), ``name``, ``x``, ``y``, ``sd`` (standard deviation),
        ``quality`` and ``status``; positions in image pixels. Frames of a track have ``frame`` and ``time`` instead of
        ``image``, and specimens have ``specimen``. An image that could not be fitted has the status ``error`` and NaN
        for as many landmarks as the others. Results of one list must be of one kind.

    Raises
    ------
    LiaamError
        If pandas is missing, there is another number of names, or something else is given.

    Examples
    --------
    >>> table = liaam.to_dataframe(liaam.fit_many(model, paths))                           # doctest: +SKIP
    >>> table[table.status == "converged"].groupby("landmark")[["x", "y"]].mean()          # doctest: +SKIP
    """
    try:
        import pandas
    except ImportError as fault:
        raise LiaamError(f"data frames need pandas; run {installing('pandas')}") from fault
    if isinstance(results, Mapping):
        return pandas.DataFrame(results)
    single = hasattr(results, "to_columns")
    return pandas.DataFrame(
        joined([results] if single else list(results), None if names is None else list(names), absent)
    )


def joined(results: Sequence[Any], names: Sequence[str] | None = None, absent: str = "empty") -> Columns:
    """Join the tables of several results; see :func:`to_dataframe`."""
    if names is not None and len(names) != len(results):
        raise LiaamError(f"{len(results)} results but {len(names)} names; give one name for each")
    tables: list[dict[str, Any]] = []
    for i, result in enumerate(results):
        name = names[i] if names is not None else None
        unnamed = hasattr(result, "image") and not isinstance(result.image, Path)
        if isinstance(result, LiaamError):  # of an image that could not be fitted, only its name is known
            tables.append({"image": name or f"image {i + 1}"})
        elif hasattr(result, "to_columns"):
            options = {"absent": absent} if hasattr(result, "absent") else {}  # only fits say what is absent
            own_name = [name or f"image {i + 1}"] if name or unnamed else []
            tables.append(result.to_columns(*own_name, **options))
        else:
            raise LiaamError(f"result {i + 1} is {type(result).__name__}; give fits, tracked frames or specimens")
    filled = [table for table in tables if "landmark" in table]
    if not filled:
        return {}
    first = filled[0]
    unknown = np.full((len(filled[0]["landmark"]), 2), np.nan)
    more = {"names": first["name"], "quality": math.nan, "status": "error"}
    tables = [table if "landmark" in table else landmark_columns(table, unknown, **more) for table in tables]
    other = next((table for table in tables if table.keys() != first.keys()), None)
    if other is not None:
        raise LiaamError(
            f"results of different kinds, by {next(iter(first))} and by {next(iter(other))}; convert each kind alone"
        )
    return {column: list(chain.from_iterable(table[column] for table in tables)) for column in first}
