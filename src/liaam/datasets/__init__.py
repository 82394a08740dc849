"""Sets of landmarked images: read from a folder, or those that come with liaam."""

from liaam.datasets.dataset import Dataset, Sample, UnusedFile
from liaam.datasets.folder import load_folder
from liaam.datasets.heads import load_face, load_heads

__all__ = ["Dataset", "Sample", "UnusedFile", "load_face", "load_folder", "load_heads"]
