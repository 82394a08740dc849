"""Checks of the tensors and numbers of a model file."""

import numpy as np

UNIT = 0.1
"""Tolerance of scalar products of orthonormal modes; weak modes have large rounding errors."""


def symmetric(upper: np.ndarray, c: int) -> np.ndarray:
    """Return the symmetric matrices (n, c, c) of upper triangles."""
    rows, columns = np.triu_indices(c)
    matrices = np.empty((len(upper), c, c), upper.dtype)
    matrices[:, rows, columns] = matrices[:, columns, rows] = upper
    return matrices


def half_or_single(tensors: dict[str, np.ndarray], key: str, shape: tuple) -> np.ndarray:
    """A tensor in 16 or 32 bits, in single precision."""
    dtype = np.float16 if tensors[key].dtype == np.float16 else np.float32
    return checked_tensor(tensors, key, dtype, shape).astype(np.float32, copy=False)


def optional_tensor(tensors: dict[str, np.ndarray], key: str, dtype: type, shape: tuple) -> np.ndarray | None:
    """Return a tensor as :func:`checked_tensor` does, or None if there is none."""
    return checked_tensor(tensors, key, dtype, shape) if key in tensors else None


def checked_tensor(tensors: dict[str, np.ndarray], key: str, dtype: type, shape: tuple) -> np.ndarray:
    """Return a tensor of a type and shape (None for any length), whose values its name allows. Raises ValueError."""
    tensor = tensors[key]
    fits = tensor.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, tensor.shape, strict=True)
    )
    if tensor.dtype != dtype or not fits:
        raise ValueError(f"{key} has type {tensor.dtype} and shape {tensor.shape}")
    if tensor.dtype.kind == "f" and not np.isfinite(tensor).all():
        raise ValueError(f"{key} has values that are not finite")
    if (key.endswith(("eigenvalues", "usable")) and (tensor < 0).any()) or (
        key.endswith("usable") and (tensor > 1).any()
    ):
        raise ValueError(f"{key} has values out of range")
    if key.endswith(("shape.unexplained", "landmarks", "bias")):
        check_variances(key, tensor)
    return tensor


def check_variances(key: str, matrices: np.ndarray) -> None:
    """Raise ValueError if a diagonal of matrices (n, c, c) has negative values."""
    if (np.diagonal(matrices, axis1=1, axis2=2) < 0).any():
        raise ValueError(f"{key} has negative variances")


def are_unit(modes: np.ndarray, at_most: bool = False) -> bool:
    """Whether modes (m, d) have unit length, or at most that if only a part of them is kept."""
    if max(modes.max(initial=0.0), -modes.min(initial=0.0)) > 2.0:  # the squares might overflow
        return False
    beyond = np.einsum("md,md->m", modes, modes) - 1.0
    return bool(((beyond if at_most else np.abs(beyond)) < UNIT).all())


def finite(value: float) -> float:
    """Return a finite number; raise ValueError for others."""
    if not np.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    return float(value)
