"""Fit a model to many images, on all cores or a cluster, resumable, with one table row per image.

A journal beside the output (:mod:`~liaam.batch.journal`) holds the list of images and the finished rows. Threads, or
the workers of a cluster (:mod:`~liaam.batch.cluster`), fit the images. At the end the table is written
(:mod:`~liaam.batch.tables`). A web page shows fits with their pictures (:mod:`~liaam.batch.report`).
"""

from liaam.batch.pictures import find_pictures, listed_pictures
from liaam.batch.report import write_report
from liaam.batch.run import Summary, run_batch
from liaam.batch.work import Settings

__all__ = ["Settings", "Summary", "find_pictures", "listed_pictures", "run_batch", "write_report"]
