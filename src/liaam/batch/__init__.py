"""Fit a model to any number of pictures: on all cores or a cluster, resumable, one row per picture.

:func:`run_batch` lists the pictures in a journal beside the output (:mod:`~liaam.batch.journal`), has chunks of them
fitted here, in worker processes or by a Dask cluster (:mod:`~liaam.batch.pools`), keeps the rows of each finished chunk
in the journal, and writes the table at the end (:mod:`~liaam.batch.tables`). Nothing is held in memory but the chunks
under way, and the table depends on pictures and settings only: not on the number of workers, nor on the order in which
they finish, nor on stops.
"""

from liaam.batch.pictures import find_pictures, listed_pictures
from liaam.batch.run import Summary, run_batch
from liaam.batch.work import Settings

__all__ = ["Settings", "Summary", "find_pictures", "listed_pictures", "run_batch"]
