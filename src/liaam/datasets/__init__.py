"""Sets of landmarked images: read from a folder, or made."""

from liaam.datasets.folder import Dataset, LeftOut, Sample, load_folder
from liaam.datasets.label_faults import LabelFault, find_label_faults

__all__ = ["Dataset", "LabelFault", "LeftOut", "Sample", "find_label_faults", "load_folder"]
