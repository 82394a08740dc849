"""Sets of landmarked images: read from a folder, or simulated."""

from liaam.datasets.folder import Dataset, LeftOut, Sample, load_folder
from liaam.lazy import submodules

__all__ = ["Dataset", "LeftOut", "Sample", "load_folder"]

__getattr__ = submodules(__name__, "scenes")
