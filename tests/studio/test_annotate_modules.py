"""The parts of the Annotate tab that need no page, by Node."""

import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
MODULES = HERE.parents[1] / "src" / "liaam" / "studio" / "static" / "js"


def test_pure_parts_of_the_annotate_tab_by_node(tmp_path):
    node = shutil.which("node")
    if not node:
        pytest.skip("node is not on this machine; the page's modules are tested in the browser only")
    # Node takes .js for modules where a package.json says so; none is needed beside what is served.
    shutil.copytree(MODULES, tmp_path / "modules")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    shutil.copy(HERE / "js" / "annotate.test.mjs", tmp_path)
    ran = subprocess.run(
        [node, "--test", "annotate.test.mjs"], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "# fail 0" in ran.stdout
    assert "# pass 0" not in ran.stdout
