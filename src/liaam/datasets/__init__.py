"""Sets of landmarked images: read from a folder, or simulated."""

from liaam.datasets.folder import Dataset, LeftOut, Sample, load_folder

__all__ = ["Dataset", "LeftOut", "Sample", "load_folder"]
