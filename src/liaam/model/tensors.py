"""Read safetensors files, with errors that name the fault. Reading never executes code from a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError, missing
from liaam.io.images import image_kind

Shapes = dict[str, tuple[int, ...]]
"""Shapes of a file's tensors."""


def read_tensors(
    path: Path, parse: Callable[[str, Shapes], Any], error: type[LiaamError], kind: str, make: str, broken: str
) -> tuple[Any, dict[str, np.ndarray]]:
    """Read the header and the tensors of a file. safetensors checks their sizes against the file's length.

    ``parse`` makes the header from the metadata entry ``liaam`` (empty if missing) and the shapes of the tensors, or
    raises. It is called before tensors are read, so that large ones of a wrong shape take no memory. Messages name the
    ``kind`` of file, such as "model file", and the command that can ``make`` one; ``broken`` is that for an incomplete
    file, with ``{fault}`` in it.
    """
    from safetensors import SafetensorError, safe_open

    try:
        if not path.is_file():
            if not path.exists():
                raise missing(error)(f"{path}: the {kind} does not exist; make one with '{make}'")
            what = "is a folder" if path.is_dir() else "is not a regular file"
            raise error(f"{path}: the {kind} {what}; make one with '{make}'")
        with safe_open(path, framework="numpy") as file:
            keys = list(file.keys())
            shapes = {key: tuple(file.get_slice(key).get_shape()) for key in keys}
            header = parse((file.metadata() or {}).get("liaam", ""), shapes)
            return header, {key: file.get_tensor(key) for key in keys}
    except LiaamError:
        raise
    except (SafetensorError, AttributeError, TypeError) as fault:  # the last two for number types that numpy lacks
        if image := image_kind(path):
            remedy = f"give a {kind} in its place, or make one with '{make}'"
            raise error(f"{path} is a {image} image, not a {kind}; {remedy}") from fault
        raise error(f"{path}: {broken.format(fault=fault)}") from fault
    except OSError as fault:
        raise error(f"{path}: the {kind} cannot be read ({fault.strerror or fault}); check its permissions") from fault
