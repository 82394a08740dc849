"""Annotations for arrays in compiled code: type of numbers, and number of axes."""

from typing import Annotated

import numpy as np

Single1 = Annotated[np.ndarray, "float32", 1]
Single2 = Annotated[np.ndarray, "float32", 2]
Single3 = Annotated[np.ndarray, "float32", 3]
Double1 = Annotated[np.ndarray, "float64", 1]
Double2 = Annotated[np.ndarray, "float64", 2]
Double3 = Annotated[np.ndarray, "float64", 3]
Int1 = Annotated[np.ndarray, "int32", 1]
Long1 = Annotated[np.ndarray, "int64", 1]
Long2 = Annotated[np.ndarray, "int64", 2]
Short1 = Annotated[np.ndarray, "int16", 1]
Byte2 = Annotated[np.ndarray, "uint8", 2]
Word2 = Annotated[np.ndarray, "uint16", 2]
Bool1 = Annotated[np.ndarray, "bool", 1]
