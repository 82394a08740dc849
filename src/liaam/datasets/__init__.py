"""Sets of landmarked images: read from a folder, or simulated."""

from typing import TYPE_CHECKING

from liaam.datasets.folder import Dataset, LeftOut, Sample, load_folder
from liaam.lazy import submodules

__all__ = ["Dataset", "LeftOut", "Sample", "load_folder"]

if TYPE_CHECKING:
    from liaam.datasets import scenes as scenes
else:
    __getattr__ = submodules(__name__, "scenes")
