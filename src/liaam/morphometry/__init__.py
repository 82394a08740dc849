"""Measures, shapes and curves of specimens from their landmarks, with standard errors and measurement errors."""

from liaam.morphometry.curves import with_even_curves
from liaam.morphometry.measures import Measure, ScaleBar
from liaam.morphometry.reading import read_specimens
from liaam.morphometry.replicates import exchanged_landmarks, measurement_error
from liaam.morphometry.scale_tables import read_lengths, with_lengths
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.table import alike, measure

__all__ = [
    "Measure",
    "ScaleBar",
    "Specimen",
    "alike",
    "exchanged_landmarks",
    "measure",
    "measurement_error",
    "read_lengths",
    "read_specimens",
    "with_even_curves",
    "with_lengths",
]
