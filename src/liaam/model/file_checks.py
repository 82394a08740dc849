"""Checks of the tensors and numbers of a model file. They raise ValueError, of which reading makes a ModelFileError."""

from dataclasses import dataclass

import numpy as np

from liaam.errors import shortened
from liaam.io.files import writable
from liaam.model.file_format import LONGEST_NAME

UNIT = 0.1  # Tolerance of scalar products of orthonormal modes; weak modes have large rounding errors


def text_of(value: object, longest: int = LONGEST_NAME) -> str:
    """Return a text of a header in a form that can be shown and written, shortened."""
    return writable(str(value))[:longest]


def half_or_single(tensors: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A tensor in 16 or 32 bits, in single precision."""
    dtype = np.float16 if tensors[key].dtype == np.float16 else np.float32
    return checked_tensor(tensors, key, dtype, shape).astype(np.float32, copy=False)


def checked_tensor(tensors: dict[str, np.ndarray], key: str, dtype: type, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return a tensor of a type and shape (None for any length), whose values its name allows. Raises ValueError."""
    tensor = tensors[key]
    if tensor.dtype != dtype or not _has_shape(tensor, shape):
        raise ValueError(f"{key} has type {tensor.dtype} and shape {tensor.shape}")
    if tensor.dtype.kind == "f" and not np.isfinite(tensor).all():
        raise ValueError(f"{key} has values that are not finite")
    if key.endswith("eigenvalues") and (tensor < 0).any():
        raise ValueError(f"{key} has values out of range")
    if key.endswith("usable") and ((tensor < 0).any() or (tensor > 1).any()):
        raise ValueError(f"{key} has values out of range")
    if key.endswith(("shape.unexplained", "landmarks", "bias", "scales")):
        check_variances(key, tensor)
    return tensor


def _has_shape(tensor: np.ndarray, shape: tuple[int | None, ...]) -> bool:
    """Return whether a tensor has a shape, of which None stands for any length."""
    if tensor.ndim != len(shape):
        return False
    return all(expected in (None, length) for expected, length in zip(shape, tensor.shape, strict=True))


def check_variances(key: str, matrices: np.ndarray) -> None:
    """Raise ValueError if a diagonal of matrices (n, c, c) has negative values."""
    if (np.diagonal(matrices, axis1=1, axis2=2) < 0).any():
        raise ValueError(f"{key} has negative variances")


@dataclass(frozen=True)
class _Rounding:
    """By how much rounding may make a covariance asymmetric or indefinite."""

    of_trace: float  # relative to the trace
    least: float  # added to that, since the smallest numbers of a type are this far apart, or less


EXACT = _Rounding(of_trace=1e-9, least=1e-12)  # Of double precision, after the sums of a covariance
ROUNDED = _Rounding(of_trace=1e-2, least=1e-6)  # Of the 16 bits in which errors of appearances are stored


def check_covariances(key: str, matrices: np.ndarray, largest: float, rounding: _Rounding = EXACT) -> None:
    """Raise ValueError unless matrices (n, c, c) are symmetric and positive semidefinite, with bounded variances."""
    check_magnitude(key, matrices, largest)
    matrices = matrices.astype(np.float64, copy=False)
    allowed = rounding.of_trace * np.trace(matrices, axis1=1, axis2=2) + rounding.least
    if (np.abs(matrices - matrices.swapaxes(1, 2)) > allowed[:, None, None]).any():
        raise ValueError(f"{key} has matrices that are not symmetric")
    try:
        np.linalg.cholesky(matrices + allowed[:, None, None] * np.eye(matrices.shape[1]))
    except np.linalg.LinAlgError as error:
        raise ValueError(f"{key} has matrices that are not positive semidefinite") from error


def check_magnitude(key: str, values: np.ndarray, largest: float) -> None:
    """Raise ValueError if a value exceeds the largest magnitude."""
    if max(values.max(initial=0.0), -values.min(initial=0.0)) > largest:
        raise ValueError(f"{key} has values beyond {largest:g}")


def are_unit(modes: np.ndarray, at_most: bool = False) -> bool:
    """Whether modes (m, d) have unit length, or at most that if only a part of them is kept."""
    if max(modes.max(initial=0.0), -modes.min(initial=0.0)) > 2.0:  # the squares might overflow
        return False
    beyond = np.einsum("md,md->m", modes, modes) - 1.0
    return bool(((beyond if at_most else np.abs(beyond)) < UNIT).all())


def finite(value: float) -> float:
    """Return a finite number; raise ValueError for others."""
    if not np.isfinite(value):
        raise ValueError(f"{shortened(value)} is not a finite number")
    return float(value)


def number_of(tensors: dict[str, np.ndarray], key: str) -> float:
    """Return the value of a tensor of one number."""
    return float(checked_tensor(tensors, key, np.float64, (1,))[0])
