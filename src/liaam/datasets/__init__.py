"""Sets of landmarked images: read from a folder, or those that come with liaam."""

from liaam.datasets.folder import Dataset, LeftOut, Sample, load_folder
from liaam.datasets.heads import load_face, load_heads

__all__ = ["Dataset", "LeftOut", "Sample", "load_face", "load_folder", "load_heads"]
