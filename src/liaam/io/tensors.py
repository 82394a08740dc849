"""Reading safetensors files: what is in them, or an error that says what is wrong. Nothing in a file is ever run."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError


def read_tensors(
    path: Path, parse: Callable[[str], Any], error: type[LiaamError], kind: str, make: str, broken: str
) -> tuple[Any, dict[str, np.ndarray]]:
    """Read a file's header and its tensors; sizes are checked by safetensors against the file's own length.

    Parameters
    ----------
    path : Path
    parse : callable
        Makes a header of the metadata's entry ``liaam`` (empty if there is none), or complains; called first.
    error : type of LiaamError
        The class of error to raise.
    kind, make : str
        What the file should be, "model file", and the command that makes one, for messages.
    broken : str
        What to say of a file that is not whole; ``{fault}`` stands for the fault.

    Raises
    ------
    LiaamError
        Of class `error`, if the file is missing, cut short, or of another kind.
    """
    from safetensors import SafetensorError, safe_open

    try:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "is no ordinary file" if path.exists() else "does not exist"
            raise error(f"{path}: the {kind} {what}; make one with '{make}'")
        with safe_open(path, framework="numpy") as file:
            header = parse((file.metadata() or {}).get("liaam", ""))
            return header, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (no mapping)
    except (SafetensorError, AttributeError, TypeError) as fault:  # the last two: number types that numpy lacks
        raise error(f"{path}: {broken.format(fault=fault)}") from fault
    except OSError as fault:
        raise error(f"{path}: the {kind} cannot be read ({fault.strerror or fault})") from fault
