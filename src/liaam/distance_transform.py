"""Distances from the border of a mask, the same bits in every run."""

import cv2
import numpy as np

ALIGNMENT = 64  # bytes; a multiple of what processors compute with at once


def distance_transform(mask: np.ndarray) -> np.ndarray:
    """Return the distance of each pixel of a mask (h, w) from the nearest pixel outside, (h, w) float32, pixels.

    OpenCV's last bits depend on where the result lies in memory: here, always at a multiple of ``ALIGNMENT``.
    """
    n_bytes = mask.size * np.dtype(np.float32).itemsize
    memory = np.empty(n_bytes + ALIGNMENT, np.uint8)  # with room to begin at the next aligned address
    begin = (-memory.ctypes.data) % ALIGNMENT  # bytes up to that address
    distances = memory[begin : begin + n_bytes].view(np.float32).reshape(mask.shape)
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, distances)
