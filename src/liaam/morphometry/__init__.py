"""Measures, shapes and curves of specimens from their landmarks, with standard errors and measurement errors."""

from liaam.morphometry.curves import with_even_curves as with_even_curves
from liaam.morphometry.measures import Measure as Measure, ScaleBar as ScaleBar
from liaam.morphometry.replicates import measurement_error as measurement_error
from liaam.morphometry.specimens import Specimen as Specimen, read_specimens as read_specimens
from liaam.morphometry.table import alike as alike, measure as measure
