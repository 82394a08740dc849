"""The check of a release fails for each of its wrong inputs, and this checkout passes it."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / ".ci/release_check.py"
FILES = (
    "pyproject.toml",
    "CHANGELOG.md",
    "CITATION.cff",
    "CITATION.bib",
    "conda/recipe.yaml",
    "src/liaam/__init__.py",
)
DAY = "2026-12-31"

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason="a source distribution has no .ci")


@pytest.fixture(scope="module")
def release_check():
    specification = importlib.util.spec_from_file_location("release_check", PROGRAM)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def version(release_check):
    return release_check.tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


@pytest.fixture
def checkout(tmp_path, version):
    """The files of a release that is ready, on some day."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    replace_in(tmp_path / "CHANGELOG.md", f"## [{version}] - Unreleased", f"## [{version}] - {DAY}")
    with (tmp_path / "CITATION.cff").open("a", encoding="utf-8") as file:
        file.write(f"date-released: {DAY}\n")
    return tmp_path


def replace_in(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_this_checkout_agrees():
    ran = subprocess.run([sys.executable, PROGRAM], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")


def test_the_program_fails_for_a_wrong_tag():
    ran = subprocess.run([sys.executable, PROGRAM, "v99.0.0"], capture_output=True, text=True, check=False)
    assert ran.returncode == 1 and "the tag v99.0.0 is not v" in ran.stderr


def test_a_release_that_is_ready_passes(release_check, checkout, version):
    assert release_check.faults(checkout) == []
    assert release_check.faults(checkout, f"v{version}") == []


@pytest.mark.parametrize(
    ("name", "old", "new", "fault"),
    [
        ("src/liaam/__init__.py", '__version__ = "{}"', '__version__ = "9.9.9"', "it states the version 9.9.9"),
        ("src/liaam/__init__.py", "__version__", "__edition__", "it states no version"),
        ("CITATION.cff", "\nversion: {}", "\nversion: 9.9.9", "it states the version 9.9.9"),
        ("CITATION.cff", "  version: {}", "  version: 9.9.9", "it states the version 9.9.9"),
        ("CITATION.bib", "{{{}}}", "{{9.9.9}}", "it states the version 9.9.9"),
        ("conda/recipe.yaml", '"{}"', '"9.9.9"', "it states the version 9.9.9"),
        ("pyproject.toml", 'version = "{}"', 'version = "1"', "'1' is not one such as 1.2.3"),
        ("CHANGELOG.md", "## [{}]", "## [9.9.9]", "the first section is of version 9.9.9"),
        ("CHANGELOG.md", DAY, "31 December", "'31 December' is neither a date such as 2026-12-31 nor Unreleased"),
        ("CHANGELOG.md", DAY, "20261231", "'20261231' is neither a date"),
        ("CHANGELOG.md", "## [", "### [", "it has no section"),
    ],
)
def test_files_that_disagree_are_named(release_check, checkout, version, name, old, new, fault):
    replace_in(checkout / name, old.format(version), new.format(version))
    assert any(line.startswith(f"{name}: ") and fault in line for line in release_check.faults(checkout))


@pytest.mark.parametrize(
    ("name", "old", "new", "fault"),
    [
        ("CHANGELOG.md", DAY, "Unreleased", "is Unreleased; write the date"),
        ("CITATION.cff", DAY, "2026-12-30", f"date-released is 2026-12-30; write the date of the changelog, {DAY}"),
        ("CITATION.cff", "date-released", "date-written", "date-released is none"),
    ],
)
def test_a_tag_needs_dates_that_agree(release_check, checkout, version, name, old, new, fault):
    replace_in(checkout / name, old, new)
    assert not release_check.faults(checkout)  # without a tag, the release need not be ready
    assert any(line.startswith(f"{name}: ") and fault in line for line in release_check.faults(checkout, f"v{version}"))


@pytest.mark.parametrize("tag", ["v9.9.9", "{}", "release-{}", "v{}rc1"])
def test_a_tag_is_the_version_with_a_v(release_check, checkout, version, tag):
    (line,) = release_check.faults(checkout, tag.format(version))
    assert line.startswith("the tag ") and f"is not v{version}" in line
