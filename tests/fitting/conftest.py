"""What several tests of fits share."""

import pytest

from setups import train_on


@pytest.fixture(scope="session")
def calibrated(scenes):
    """Give a model that has learnt how far its fits can be trusted."""
    return train_on(scenes, diagonal=60.0, leave_out=True)
