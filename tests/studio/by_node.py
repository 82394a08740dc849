"""Tests of the page's modules that need no page, by Node."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

HERE = Path(__file__).parent
MODULES = HERE.parents[1] / "src" / "liaam" / "studio" / "static" / "js"


def run_by_node(test: str, folder: Path, environment: Mapping[str, str] | None = None) -> None:
    """Run a file of ``js`` in a folder, with the page's modules beside it; skip where there is no Node."""
    node = shutil.which("node")
    if not node:
        pytest.skip("node is not on this machine; the page's modules are tested in the browser only")
    # Node takes .js for modules where a package.json says so; none is needed beside what is served.
    shutil.copytree(MODULES, folder / "modules")
    shutil.copytree(MODULES.parent / "vendor", folder / "vendor")
    (folder / "package.json").write_text('{"type": "module"}')
    shutil.copy(HERE / "js" / test, folder)
    ran = subprocess.run(
        [node, "--test", test],
        cwd=folder,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "# fail 0" in ran.stdout
    assert "# pass 0" not in ran.stdout
