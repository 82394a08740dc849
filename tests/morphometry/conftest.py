"""Fixtures of the tests of specimens."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def geomorph(shared_data: Path) -> Path:
    """Give the folder of data and results of the R package geomorph; tests that need it skip where it is absent."""
    folder = shared_data / "geomorph"
    if not folder.is_dir():
        pytest.skip(f"results of geomorph are not at {folder}")
    return folder
