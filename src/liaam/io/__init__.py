"""Reading and writing of images, videos and landmark files. All files are written atomically."""

from liaam.io.atomic import atomic_path, write_bytes_atomically, write_text_atomically
from liaam.io.files import make_folder
from liaam.io.images import (
    IMAGE_SUFFIXES,
    decode_image,
    image_kind,
    image_size,
    read_image,
    read_preview,
    read_strips,
    write_image,
)
from liaam.io.landmarks import (
    LANDMARK_SUFFIXES,
    Contour,
    Landmarks,
    Reading,
    read_collection,
    read_landmarks,
    write_collection,
    write_landmarks,
)
from liaam.io.raw import is_raw
from liaam.io.table_writer import write_columns
from liaam.io.video import VideoFrame, VideoReader
from liaam.io.video_writer import VideoWriter, video_writer

__all__ = [
    "IMAGE_SUFFIXES",
    "LANDMARK_SUFFIXES",
    "Contour",
    "Landmarks",
    "Reading",
    "VideoFrame",
    "VideoReader",
    "VideoWriter",
    "atomic_path",
    "decode_image",
    "image_kind",
    "image_size",
    "is_raw",
    "make_folder",
    "read_collection",
    "read_image",
    "read_landmarks",
    "read_preview",
    "read_strips",
    "video_writer",
    "write_bytes_atomically",
    "write_collection",
    "write_columns",
    "write_image",
    "write_landmarks",
    "write_text_atomically",
]
