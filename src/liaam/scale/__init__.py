"""The length of a pixel, with its unit and standard error: given, from the tags of an image, or from a ruler in it."""

from liaam.scale.bar import Bar
from liaam.scale.bars import find_bar
from liaam.scale.lengths import UNITS, Length, parse_length, unlike
from liaam.scale.rulers import Ruler, find_ruler
from liaam.scale.tags import length_in_tags

__all__ = ["UNITS", "Bar", "Length", "Ruler", "find_bar", "find_ruler", "length_in_tags", "parse_length", "unlike"]
