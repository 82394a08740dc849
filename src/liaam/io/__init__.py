"""Reading and writing of images, videos and landmark files. All files are written atomically."""

from liaam.io.atomic import (
    atomic_path as atomic_path,
    write_bytes_atomically as write_bytes_atomically,
    write_text_atomically as write_text_atomically,
)
from liaam.io.files import make_folder as make_folder
from liaam.io.images import (
    IMAGE_SUFFIXES as IMAGE_SUFFIXES,
    decode_image as decode_image,
    image_kind as image_kind,
    image_size as image_size,
    read_image as read_image,
    read_preview as read_preview,
    write_image as write_image,
)
from liaam.io.landmarks import (
    LANDMARK_SUFFIXES as LANDMARK_SUFFIXES,
    Contour as Contour,
    Landmarks as Landmarks,
    Reading as Reading,
    read_collection as read_collection,
    read_landmarks as read_landmarks,
    write_collection as write_collection,
    write_landmarks as write_landmarks,
)
from liaam.io.raw import is_raw as is_raw
from liaam.io.table_writer import write_columns as write_columns
from liaam.io.video import VideoFrame as VideoFrame, VideoReader as VideoReader
from liaam.io.video_writer import VideoWriter as VideoWriter, video_writer as video_writer
