"""The two kernels of the loop, with the same interface.

``fast`` is the compiled loop of :mod:`liaam.fitting.loop`. ``reference`` runs the same code in the interpreter, with
the loops over pixels replaced by the NumPy functions of :mod:`liaam.fitting.reference`. It accepts any warp.
"""

import builtins
from functools import lru_cache
from types import FunctionType, SimpleNamespace

from liaam.errors import MethodError
from liaam.fitting import equations, evaluate, jacobian, loop, proposal, reference, residual, steps, weights
from liaam.kernels.compiled import Record

KERNELS = ("fast", "reference")

CORE = (equations, weights, residual, jacobian, evaluate, steps, proposal, loop)
"""Modules of the loop."""


@lru_cache(maxsize=len(KERNELS))
def get_kernel(name: str = "fast") -> SimpleNamespace:
    """Return the functions of a kernel by name.

    Raises
    ------
    MethodError
        If no kernel has that name.
    """
    if name not in KERNELS:
        raise MethodError(f"kernel {name!r} does not exist; there are {', '.join(KERNELS)}")
    names = {key: value for module in CORE for key, value in vars(module).items() if not key.startswith("__")}
    names["by_reference"] = Record
    if name == "fast":
        return SimpleNamespace(**names)
    plain = {key: value for key, value in vars(reference).items() if isinstance(value, FunctionType)}
    names.update(plain, __builtins__=builtins)
    lines = {key: getattr(value, "py_func", value if key in plain else None) for key, value in names.items()}
    for key, line in lines.items():
        if isinstance(line, FunctionType):  # copied, with ``names`` as its globals
            names[key] = FunctionType(line.__code__, names, key, line.__defaults__, line.__closure__)
    return SimpleNamespace(**names)
