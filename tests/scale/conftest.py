"""Fixtures of the tests of scales."""

import numpy as np
import pytest

NOTHING = {
    "no rows": np.zeros((0, 9, 3), np.uint8),
    "one pixel": np.zeros((1, 1), np.float32),
    "black": np.zeros((200, 300, 3), np.uint8),
    "no values": np.full((200, 300), np.nan, np.float32),
    "huge values": np.full((200, 300), 1e38, np.float32),
    "endless values": np.full((200, 300), np.inf, np.float32),
    "two rows": np.zeros((2, 3000), np.uint8),
}


@pytest.fixture(params=NOTHING.values(), ids=NOTHING)
def image_of_nothing(request: pytest.FixtureRequest) -> np.ndarray:
    """Give images in which there is nothing to find, one after the other."""
    return request.param
