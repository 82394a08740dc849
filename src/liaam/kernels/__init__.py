"""Kernels: sampling an encoded image, differentiating the projected samples, and weighing them.

Both kernels keep one contract, that of :mod:`liaam.kernels.reference`. ``fast`` is numba for single images,
``reference`` plain array code that says what the result has to be; its forms for batches run on any array library
(:mod:`liaam.kernels.backends`).
"""

from functools import lru_cache
from types import ModuleType

from liaam.errors import MethodError

KERNELS = ("fast", "reference")


@lru_cache(maxsize=len(KERNELS))
def get_kernel(name: str = "fast") -> ModuleType:
    """Module of a kernel by name (imported when first asked for: numba is slow to import)."""
    if name == "fast":
        from liaam.kernels import fast

        return fast
    if name == "reference":
        from liaam.kernels import reference

        return reference
    raise MethodError(f"kernel {name!r} does not exist; there are {', '.join(KERNELS)}")
