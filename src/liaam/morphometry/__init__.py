"""Measures, shapes and curves of specimens from their landmarks, with standard errors and measurement errors."""

from liaam.morphometry.curves import with_even_curves
from liaam.morphometry.measures import Measure, ScaleBar
from liaam.morphometry.replicates import measurement_error
from liaam.morphometry.specimens import Specimen, read_specimens
from liaam.morphometry.table import alike, measure

__all__ = [
    "Measure",
    "ScaleBar",
    "Specimen",
    "alike",
    "measure",
    "measurement_error",
    "read_specimens",
    "with_even_curves",
]
