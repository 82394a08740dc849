"""Models that come with liaam, by name. Their files are beside this one; ``making/`` of a checkout makes them."""

import os
from pathlib import Path

FACE = "face"
"""Name of the model that ``liaam fit`` uses if none is given."""

MODELS = (FACE,)
"""Names of the models. Their files say what they are for, and on what terms (:attr:`liaam.AAM.card`)."""


def model_file(path: str | os.PathLike) -> Path:
    """Return the file of the model that comes with liaam under this name or, of any other text, the path itself."""
    name = os.fspath(path)
    return Path(__file__).with_name(f"{name}.liaam") if name in MODELS else Path(path)
