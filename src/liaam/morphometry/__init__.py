"""Distances, angles, areas and shapes of specimens from their landmarks, with standard errors."""

from liaam.morphometry.measures import Measure, ScaleBar
from liaam.morphometry.specimens import Specimen, read_specimens
from liaam.morphometry.table import alike, measure, write_measurements

__all__ = ["Measure", "ScaleBar", "Specimen", "alike", "measure", "read_specimens", "write_measurements"]
