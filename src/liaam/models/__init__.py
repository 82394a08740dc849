"""Models that come with liaam, by name. Their files are beside this one; ``making/`` of a checkout makes them."""

import os
from dataclasses import dataclass
from pathlib import Path

FACE = "face"
"""Name of the model that ``liaam fit`` uses if none is given."""


@dataclass(frozen=True)
class Included:
    """What a model that comes with liaam is for, and how accurate it was measured to be."""

    purpose: str
    accuracy: str


MODELS = {
    FACE: Included(
        "faces of heads turned by up to 40°, neutral or smiling, in any light",
        "median errors for unknown persons, % of the distance between the eyes: 1.7 under hard flashes, 3.7 frontal, "
        "4.5 in spot light, 5.3 smiling, 5.5 turned by 30° (5 % are lost), 3.5 in photographs of any kind (16 % lost)",
    )
}
"""The models by name. Their credit and terms are in the files (:attr:`liaam.model.AAM.credit`)."""


def model_file(path: str | os.PathLike) -> Path:
    """Return the file of the model that comes with liaam under this name or, of any other text, the path itself."""
    name = os.fspath(path)
    return Path(__file__).with_name(f"{name}.liaam") if name in MODELS else Path(path)
