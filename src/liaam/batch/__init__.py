"""Fit a model to many images, on all cores or a cluster, resumable, with one table row per image.

:func:`run_batch` lists the images in a journal beside the output (:mod:`~liaam.batch.journal`). It fits them in chunks,
in this process, in worker processes or on a Dask cluster (:mod:`~liaam.batch.pools`), and stores the rows of each
finished chunk in the journal. At the end it writes the table (:mod:`~liaam.batch.tables`). Only the chunks in progress
are in memory. The table depends only on images and settings, not on the number of workers, their order or
interruptions.
"""

from liaam.batch.pictures import find_pictures, listed_pictures
from liaam.batch.run import Summary, run_batch
from liaam.batch.work import Settings

__all__ = ["Settings", "Summary", "find_pictures", "listed_pictures", "run_batch"]
