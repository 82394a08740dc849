"""Fitting many images with one model on several threads."""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from functools import partial
from itertools import repeat
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from liaam.errors import ImageError, LiaamError, MethodError, StartError
from liaam.fitting.detection import Detection
from liaam.fitting.fitter import Fitter
from liaam.fitting.methods import DEFAULT_METHOD, Method
from liaam.fitting.result import FitResult
from liaam.io.files import count_of
from liaam.model import AAM
from liaam.progress import progress_bar
from liaam.workers import all_cores, in_order, one_thread

ERRORS = ("raise", "return")
"""What to do about an image that cannot be fitted."""

_ONE_OR_EACH = "give one start for all images, or one for each"

# Types of arguments, for the overloads: what is returned depends on ``every`` and ``errors``.
ModelOrName = AAM | str
No = Literal[False]
Raise = Literal["raise"]
Return = Literal["return"]


class _Task(NamedTuple):
    """An image to fit."""

    image: Any  # array or path
    init: Any  # its start, or None
    name: str  # in messages


@overload
def fit_many(
    model: ModelOrName, images: Iterable, init=..., method=..., *, every: No = ..., errors: Raise = ..., **settings
) -> list[FitResult]: ...
@overload
def fit_many(
    model: ModelOrName, images: Iterable, init=..., method=..., *, every: No = ..., errors: Return, **settings
) -> list[FitResult | LiaamError]: ...
@overload
def fit_many(
    model: ModelOrName, images: Iterable, init=..., method=..., *, every: Literal[True], errors: Raise = ..., **settings
) -> list[list[FitResult]]: ...
@overload
def fit_many(
    model: ModelOrName, images: Iterable, init=..., method=..., *, every: Literal[True], errors: Return, **settings
) -> list[list[FitResult] | LiaamError]: ...
def fit_many(
    model: AAM | str,
    images: Iterable,
    init=None,
    method: str | Method = DEFAULT_METHOD,
    *,
    every: bool = False,
    workers: int | None = None,
    progress: bool | None = None,
    errors: str = "raise",
    **settings,
) -> list:
    """Fit a model to many images, on all cores.

    Results do not depend on the number of workers, and equal those of :func:`liaam.fit` bit for bit if BLAS uses one
    thread there. Meanwhile BLAS and OpenCV use one thread each in the whole process. Ctrl-C stops after running fits.

    Parameters
    ----------
    model : AAM or "face"
    images : iterable of (h, w, 3) uint8, uint16 or float arrays, or of paths
        Read as needed, so that a generator never has more than a few images in memory.
    init : start, or iterable of starts, optional
        One start for all images, or one per image, as for :meth:`liaam.fitting.Fitter.fit`. Objects without a start
        (None) are searched for.
    method : str or Method
        See :data:`liaam.fitting.METHODS`.
    every : bool
        Fit every object that the search finds in an image, instead of one. Without this, ``result.n_found`` says how
        many there are.
    workers : int, optional
        Number of threads; by default one per core available to the process.
    progress : bool, optional
        Whether to show a progress bar on standard error; by default on a terminal, after two seconds.
    errors : {"raise", "return"}
        If an image cannot be fitted (a damaged file, or a grey image for a method that compares colours), raise the
        first error, or return the error in place of the result. Fits that fail are results with a status in both cases.
    **settings
        Other keyword arguments of :func:`liaam.fitting.fit`: ``camera``, ``rotations``, ``restarts``, ``margin``,
        ``side``, and fields of :class:`liaam.fitting.SolverOptions`.

    Returns
    -------
    list of FitResult
        In the order of the images; with ``every``, a list of results for each image (:meth:`Fitter.fit_all`). With
        ``errors="return"``, LiaamError for images that cannot be fitted.

    Raises
    ------
    LiaamError
        For the first image that cannot be fitted, named by its file or as ``images[3]``; and if the numbers of images
        and starts differ.

    Examples
    --------
    >>> results = fit_many(model, sorted(Path("faces").glob("*.png")))                    # doctest: +SKIP
    >>> shapes = [result.landmarks for result in results if result.status.ok]               # doctest: +SKIP
    """
    fitter = Fitter.of(model, method, caller=fit_many, **settings)
    return list(fit_each(fitter, images, init, every=every, workers=workers, progress=progress, errors=errors))


def fit_each(
    fitter: Fitter,
    images: Iterable,
    init=None,
    *,
    every: bool = False,
    workers: int | None = None,
    progress: bool | None = None,
    errors: str = "raise",
) -> Generator[Any, None, None]:
    """Fit many images as :func:`fit_many` does, but yield each result when it is ready.

    Threads run until the last result is taken or the generator is closed.

    Parameters
    ----------
    fitter : Fitter
    images, init, every, workers, progress, errors
        As for :func:`fit_many`.

    Yields
    ------
    FitResult, list of FitResult, or LiaamError
    """
    workers = all_cores() if workers is None else workers
    if workers < 1:
        raise MethodError(f"workers {workers} is too small; give 1 or more, or leave it out for one per core")
    if errors not in ERRORS:
        raise MethodError(f"unknown errors {errors!r}; choose from {', '.join(ERRORS)}")
    refuse_one_start(every, init)
    n_images = _count(images)
    tasks = _tasks(images, starts_for(init, n_images))
    perform = partial(_fit, fitter, every, errors)
    return _fits(perform, tasks, workers, n_images, progress)


def refuse_one_start(every: bool, init: Any) -> None:
    """Raise if every object is to be fitted and a start is given."""
    if every and init is not None:
        raise StartError("every object is searched for, and init gives the place of one: use only one of them")


def _fits(
    perform: Callable, tasks: Iterable[_Task], workers: int, n_images: int | None, progress: bool | None
) -> Generator[Any, None, None]:
    """Perform tasks on threads, and yield the results in their order; ``n_images`` is None if it is unknown."""
    done = 0
    threads = workers if n_images is None else max(1, min(workers, n_images))
    with one_thread(), progress_bar("images", n_images, progress) as tell:
        fits = in_order(perform, tasks, threads, tick=lambda: tell(done))
        with closing(fits):
            for result in fits:
                done += 1
                tell(done)
                yield result


def _fit(fitter: Fitter, every: bool, errors: str, task: _Task) -> FitResult | list[FitResult] | LiaamError:
    """Fit one image, or every object in it; return errors of the image if they are not to be raised."""
    try:
        if every:
            return fitter.fit_all(task.image, task.name)
        return fitter.fit(task.image, task.init, task.name)
    except LiaamError as error:
        if errors == "raise":
            raise
        return _without_frames(error)
    except Exception as error:
        error.add_note(f"liaam was fitting {task.image if _is_path(task.image) else task.name}")
        raise


def _without_frames(error: LiaamError) -> LiaamError:
    """Remove an error's tracebacks, which keep the image in memory."""
    fault: BaseException | None = error
    while fault is not None:
        fault.__traceback__ = None
        fault = fault.__cause__ or fault.__context__
    return error


def _count(images: Iterable) -> int | None:
    """Return the number of images, or None if unknown; raise an error for a single image."""
    single = _is_path(images) or (isinstance(images, np.ndarray) and images.ndim in (2, 3))
    if single or not isinstance(images, Iterable):
        raise ImageError("images is not a list; give a list of images or paths, also for a single one: [image]")
    return _length(images)


def _length(several) -> int | None:
    """Return the length of an iterable, or None if it has none, such as a generator."""
    return len(several) if hasattr(several, "__len__") else None


def _is_path(image) -> bool:
    return isinstance(image, (str, os.PathLike))


def starts_for(init, n_images: int | None) -> Iterable:
    """Return an iterable over the starts of the images: a :class:`itertools.repeat` if there is one for all."""
    if init is None or _is_one_start(init):
        return repeat(init)
    if _is_path(init) or not isinstance(init, Iterable):
        raise StartError(f"init {init!r} is not valid; {_ONE_OR_EACH}")
    n_starts = _length(init)
    if n_images is not None and n_starts is not None and n_starts != n_images:
        raise StartError(f"{count_of(n_images, 'image')} but {count_of(n_starts, 'start')}; {_ONE_OR_EACH}")
    return init


def _is_one_start(init) -> bool:
    """Return whether ``init`` is one start (a shape, a box, a point and a size), not several."""
    if isinstance(init, Detection) or hasattr(init, "points"):
        return True
    if isinstance(init, (list, tuple)) and any(start is None for start in init):
        return False  # NumPy would convert None to NaN
    try:
        numbers = np.asarray(init, dtype=np.float64)
    except (TypeError, ValueError):  # of different lengths, or not numeric
        return False
    is_box_or_place = numbers.ndim == 1 and numbers.size > 0
    is_shape = numbers.ndim == 2 and numbers.shape[1] == 2
    return is_box_or_place or is_shape


def _tasks(images: Iterable, starts: Iterable) -> Iterator[_Task]:
    """Yield each image with its start, and its name in messages; raise an error if their numbers differ."""
    remaining_starts = iter(starts)
    n_images = 0
    for image in images:
        try:
            start = next(remaining_starts)
        except StopIteration:
            fault = f"more than {count_of(n_images, 'image')} but {count_of(n_images, 'start')}"
            raise StartError(f"{fault}; {_ONE_OR_EACH}") from None
        yield _Task(image, start, name=f"images[{n_images}]")
        n_images += 1
    is_one_start_for_all = isinstance(starts, repeat)
    end = object()  # differs from every start
    if not is_one_start_for_all and next(remaining_starts, end) is not end:
        raise StartError(f"{count_of(n_images, 'image')} but more starts; {_ONE_OR_EACH}")
