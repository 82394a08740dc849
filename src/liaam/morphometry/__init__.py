"""Measures, shapes, curves and asymmetry of specimens from their landmarks, with their standard errors."""

from liaam.morphometry.asymmetry import MATCHING, OBJECT, AsymmetryResult, asymmetry
from liaam.morphometry.curves import with_even_curves
from liaam.morphometry.groups import groups_in, groups_of, read_groups
from liaam.morphometry.means import p_of_means
from liaam.morphometry.measures import Measure, ScaleBar
from liaam.morphometry.missing import estimated_on_a_side, far_estimates, with_estimated_landmarks
from liaam.morphometry.reading import read_specimens
from liaam.morphometry.records import without_copies
from liaam.morphometry.replicates import exchanged_landmarks, measurement_error, replicates_repeat_errors
from liaam.morphometry.scale_tables import read_lengths, with_lengths
from liaam.morphometry.sides import individuals_of, of_one_side
from liaam.morphometry.space import Grid, ShapeSpace, shape_space, thin_plate_weights
from liaam.morphometry.specimen_tables import SpecimenTable, read_specimen_table
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.symmetry import Asymmetry, matching_asymmetry, object_asymmetry
from liaam.morphometry.table import alike, measure, measures_in, with_groups
from liaam.morphometry.variation import ShapeVariation, shape_variation

__all__ = [
    "MATCHING",
    "OBJECT",
    "Asymmetry",
    "AsymmetryResult",
    "Grid",
    "Measure",
    "ScaleBar",
    "ShapeSpace",
    "ShapeVariation",
    "Specimen",
    "SpecimenTable",
    "alike",
    "asymmetry",
    "estimated_on_a_side",
    "exchanged_landmarks",
    "far_estimates",
    "groups_in",
    "groups_of",
    "individuals_of",
    "matching_asymmetry",
    "measure",
    "measurement_error",
    "measures_in",
    "object_asymmetry",
    "of_one_side",
    "p_of_means",
    "read_groups",
    "read_lengths",
    "read_specimen_table",
    "read_specimens",
    "replicates_repeat_errors",
    "shape_space",
    "shape_variation",
    "thin_plate_weights",
    "with_estimated_landmarks",
    "with_even_curves",
    "with_groups",
    "with_lengths",
    "without_copies",
]
