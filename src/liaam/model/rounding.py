"""Rounding of modes to 8 bits: a mode is its step times whole numbers of -127 to 127.

Rounding again changes nothing, so that a model file can hold rounded modes as they are.
"""

import numpy as np

LARGEST = 127  # Largest code, of 7 bits
STEP_BITS = 16  # Significant bits of a step: with the 7 of a code fewer than the 24 of single precision, so exact


def rounded(modes: np.ndarray) -> np.ndarray:
    """Return modes (m, ...) rounded to 8 bits each, float32."""
    steps = steps_of(modes)
    return decoded(_codes(modes, steps), steps)


def encoded(modes: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return codes (m, ...) int8 and steps (m,) float32 of modes that are rounded; None if they are not."""
    with np.errstate(invalid="ignore"):  # not finite, so not rounded
        steps = steps_of(modes)
        codes = _codes(modes, steps)
    return (codes, steps) if np.array_equal(decoded(codes, steps), modes) else None


def decoded(codes: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the modes (m, ...) float32 of codes and steps."""
    return codes * _by_mode(steps, codes)


def steps_of(modes: np.ndarray) -> np.ndarray:
    """Return the step of each of the modes (m, ...), (m,) float32; 0 for a mode of zeros.

    It is the largest magnitude divided by the largest code, rounded up to the significant bits of a step.
    """
    axes_of_mode = tuple(range(1, modes.ndim))
    largest = np.abs(modes).max(axis=axes_of_mode, initial=0.0)
    mantissas, exponents = np.frexp(largest.astype(np.float64) / LARGEST)  # mantissas in [0.5, 1) times 2^exponents
    whole_mantissas = np.ceil(np.ldexp(mantissas, STEP_BITS))
    return np.ldexp(whole_mantissas, exponents - STEP_BITS).astype(np.float32)


def _codes(modes: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the nearest codes of modes (m, ...) with some steps (m,), int8; 0 for modes of zeros."""
    divisors = np.where(steps > 0, steps, np.float32(1))
    return np.rint(modes / _by_mode(divisors, modes)).astype(np.int8)


def _by_mode(steps: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Return steps (m,) as (m, 1, ...), with as many axes as the modes."""
    other_axes = (1,) * (modes.ndim - 1)
    return steps.reshape((len(steps), *other_axes))
