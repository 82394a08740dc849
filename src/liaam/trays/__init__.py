"""Photographs of several specimens: their reading order, their names by QR or bar codes, and crops."""

from liaam.trays.codes import Code, read_codes
from liaam.trays.crops import crop_box
from liaam.trays.naming import CODE, LABEL, NAME_BY, POSITION, Named, check_name_by, name_specimens
from liaam.trays.order import reading_order, touching, unplaced

__all__ = [
    "CODE",
    "LABEL",
    "NAME_BY",
    "POSITION",
    "Code",
    "Named",
    "check_name_by",
    "crop_box",
    "name_specimens",
    "read_codes",
    "reading_order",
    "touching",
    "unplaced",
]
