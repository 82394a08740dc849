"""Names of a package that load on first use, so that importing the package is quick."""

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def attach(
    package: str, homes: Mapping[str, Sequence[str]], submodules: Sequence[str] = ()
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Make the ``__getattr__`` and ``__dir__`` of a package (PEP 562).

    Parameters
    ----------
    package : str
        Name of the package.
    homes : mapping of str to sequence of str
        Names that each submodule defines. None may be the name of a submodule, which would hide it once imported.
    submodules : sequence of str
        Submodules that load on first use themselves.
    """
    assert not {name for names in homes.values() for name in names} & set(homes), "a name equals that of a submodule"
    home = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> object:
        if name in submodules:
            return import_module(f"{package}.{name}")
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *home, *submodules})

    return get, names
