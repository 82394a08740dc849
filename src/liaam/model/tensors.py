"""Read safetensors files, with errors that name the fault. Reading never executes code from a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError, missing, shortened
from liaam.io.files import check_file_size, enough_memory
from liaam.io.images import image_kind

Shapes = dict[str, tuple[int, ...]]
"""Shapes of a file's tensors."""

MOST_BYTES = 2_000_000_000  # Largest size of a file. 10,000 lamps take half of it; a model of a class of objects, 10 MB
# Largest size of a header, and largest number of its objects: every tensor is described by one. A model of four shapes
# with all appearances at ten levels has 4,500 tensors.
MOST_HEADER_BYTES = 10_000_000
MOST_ENTRIES = 10_000


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
        check_file_size(path, error, MOST_BYTES, f"make a smaller {kind} with '{make}'")
        if fault := _header_fault(path):
            raise SafetensorError(fault)
        with enough_memory(path, error), safe_open(path, framework="numpy") as file:
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
        raise error(f"{path}: {broken.format(fault=shortened(fault))}") from fault
    except OSError as fault:
        raise error(f"{path}: the {kind} cannot be read ({fault.strerror or fault}); check its permissions") from fault


def _header_fault(path: Path) -> str:
    """Return why the header of a file takes too long to parse, or nothing. Empty tensors take no other bytes."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if length > MOST_HEADER_BYTES:
            return f"its header has {length:,} bytes, more than the {MOST_HEADER_BYTES:,} allowed"
        n_entries = file.read(length).count(b"{")
    return "" if n_entries <= MOST_ENTRIES else f"its header has {n_entries:,} entries, more than {MOST_ENTRIES:,}"
