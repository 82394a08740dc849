"""Fixtures shared by all tests: seeds from test names, and the real data when it is there."""

import os
import zlib
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = Path(os.environ.get("LIAAM_SHARED_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Give a generator seeded from the test's own name: stable, and different for each test."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Give the folder of real images; tests that need it skip where it is absent (CI always has it)."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real images are not at {SHARED_DATA} (set LIAAM_SHARED_DATA)")
    return SHARED_DATA
