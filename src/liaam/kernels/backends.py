"""Array libraries that batched code runs on: NumPy, PyTorch and JAX, all spoken to by the array API standard."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np

from liaam.errors import MethodError

BACKENDS = {"numpy": "NumPy", "torch": "PyTorch", "jax": "JAX"}
"""Libraries by the name of their module, which is that of liaam's extra too."""

Array = Any
"""An array of any of them."""


@dataclass(frozen=True, eq=False)
class Backend:
    """An array library, and the device its arrays lie on.

    Attributes
    ----------
    name : {"numpy", "torch", "jax"}
    xp : module
        Namespace of the array API standard.
    device : object
        A device of the library.
    """

    name: str
    xp: ModuleType
    device: Any

    def put(self, array: np.ndarray) -> Array:
        """Array of the library on the device, of the same type."""
        return self.xp.asarray(np.ascontiguousarray(array), device=self.device)

    def fetch(self, array: Array) -> np.ndarray:
        """NumPy array of one of the library's."""
        return np.asarray(array.cpu() if self.name == "torch" else array)

    @property
    def compiles(self) -> bool:
        """Whether functions are compiled, anew for every size of their arrays."""
        return self.name == "jax"

    def compiled(self, function: Callable) -> Callable:
        """Compile a pure function of arrays (and tuples of arrays) where the library gains by it: JAX."""
        return import_module("jax").jit(function) if self.compiles else function

    def working(self) -> AbstractContextManager:
        """Context to compute in: double precision, no gradients, and no warnings of fits that blow up."""
        if self.name == "torch":
            return import_module("torch").inference_mode()
        if self.name == "jax":
            jax = import_module("jax")
            # JAX knows no double precision unless it is asked for it, and normal equations need it.
            return jax.enable_x64(True) if hasattr(jax, "enable_x64") else jax.experimental.enable_x64()
        return np.errstate(all="ignore") if self.name == "numpy" else nullcontext()


def get_backend(name: str = "numpy", device: str | None = None) -> Backend:
    """Array library by name (imported now: PyTorch and JAX take seconds).

    Parameters
    ----------
    name : {"numpy", "torch", "jax"}
    device : str, optional
        As the library calls it, such as ``cuda``, ``cuda:1`` or ``cpu``; a GPU where the library finds one if left
        out, else the CPU.

    Raises
    ------
    MethodError
        If there is no such library, it is not installed, or it has no such device.
    """
    if name not in BACKENDS:
        raise MethodError(f"backend {name!r} does not exist; there are {', '.join(BACKENDS)}")
    if find_spec(name) is None:
        raise MethodError(
            f"backend {name!r}: {BACKENDS[name]} is not installed; say 'pip install \"liaam[{name}]\"', or use backend "
            "'numpy'"
        )
    try:
        found = _DEVICES[name](device)
    except (RuntimeError, ValueError, AssertionError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise MethodError(
            f"device {device!r}: {BACKENDS[name]} cannot use it ({reason}); leave the device out, or say 'cpu'"
        ) from error
    namespace = "jax.numpy" if name == "jax" else f"array_api_compat.{name}"
    return Backend(name, import_module(namespace), found)


def _numpy_device(device: str | None) -> str:
    if device not in (None, "cpu"):
        raise ValueError("NumPy computes on the CPU only")
    return "cpu"


def _torch_device(device: str | None) -> Any:
    torch = import_module("torch")
    found = torch.device(("cuda" if torch.cuda.is_available() else "cpu") if device is None else device)
    torch.zeros(1, device=found, dtype=torch.float64)  # complains now rather than at the first picture
    return found


def _jax_device(device: str | None) -> Any:
    jax = import_module("jax")
    if device is None:
        return jax.devices()[0]
    kind, _, number = device.partition(":")
    devices = jax.devices(kind)
    if int(number or 0) >= len(devices):
        raise ValueError(f"there are {len(devices)} of kind {kind}")
    return devices[int(number or 0)]


_DEVICES = {"numpy": _numpy_device, "torch": _torch_device, "jax": _jax_device}
