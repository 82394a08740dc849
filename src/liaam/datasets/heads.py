"""Pictures that come with liaam: generated heads, and a photograph of a face.

``making/generated_heads.py`` makes the heads. LICENSE-DATA has the source and the terms of the photograph.
"""

from pathlib import Path

from liaam.datasets.dataset import Dataset, Sample
from liaam.datasets.folder import load_folder

_PICTURES = Path(__file__).with_name("pictures")
SOFT_LIGHT = _PICTURES / "soft-light"
HARD_LIGHT = _PICTURES / "hard-light"
FACE = _PICTURES / "face"


def load_heads() -> tuple[Dataset, Dataset]:
    """Load generated heads with landmarks: a set to train on, and one to test with.

    Returns
    -------
    training : Dataset
        Six heads under soft light, three images of 320×240 pixels each.
    test : Dataset
        The same heads with another pose and expression under hard light, one image of 640×480 pixels each.

    Examples
    --------
    >>> training, test = load_heads()
    >>> len(training), len(test)
    (18, 6)
    """
    return load_folder(SOFT_LIGHT), load_folder(HARD_LIGHT)


def load_face() -> Sample:
    """Load a photograph of a face in a dim room, with landmarks. The face model has not seen it.

    Returns
    -------
    Sample
        Its image has 461×615 pixels. Its 106 landmarks are in another order than those of the face model.

    Examples
    --------
    >>> sample = load_face()
    >>> sample.name, sample.read_image().shape
    ('lisa', (615, 461, 3))
    """
    return load_folder(FACE)[0]
