"""What several tests of training share."""

import pytest

from liaam.training import left_out
from liaam.training.reliability import LeftOutImage


@pytest.fixture
def left_out_images(monkeypatch) -> list[LeftOutImage]:
    """Fit no left-out images in training, and give the list of those that would be fitted from near the objects."""
    seen: list[LeftOutImage] = []
    monkeypatch.setattr(left_out, "fits_near", lambda _model, pictures, _methods: seen.extend(pictures) or {})
    monkeypatch.setattr(left_out, "with_distant_and_wrong_fits", lambda *_: {})
    return seen
