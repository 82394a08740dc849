"""Generated heads that come with liaam. ``docs/figures/make_generated_heads.py`` makes the files."""

from pathlib import Path

from liaam.datasets.folder import Dataset, load_folder

SOFT_LIGHT, HARD_LIGHT = (Path(__file__).with_name("pictures") / light for light in ("soft-light", "hard-light"))


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
