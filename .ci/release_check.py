#!/usr/bin/env python3
"""Check that the files of a release agree: ``.ci/release_check.py [TAG]``.

The version is that of pyproject.toml. The package, the citations, the recipe and the newest section of the changelog
have the same. With a tag, such as v0.1.0, the release is ready: the tag is this version, and the changelog and the
citation have the same date. Python 3.11 suffices; nothing has to be installed.
"""

import re
import sys
import tomllib
from collections.abc import Iterator
from datetime import date
from pathlib import Path

VERSION = r"\d+\.\d+\.\d+(?:(?:a|b|rc)\d+)?"  # of PEP 440, as far as this project goes
UNRELEASED = "Unreleased"

STATED = {
    "src/liaam/__init__.py": r'^__version__ = "(.*)"$',
    "CITATION.cff": r"^ *version: (.*)$",
    "CITATION.bib": r"^ *version *= *\{(.*)\},?$",
    "conda/recipe.yaml": r'^  version: "(.*)"$',
}
"""Files that state the version, each with the pattern of all places where it does."""


def faults(root: Path, tag: str = "") -> list[str]:
    """Return what is wrong with a release, one line for each file; ``tag`` is that of the release, or empty."""
    version = tomllib.loads(_text(root, "pyproject.toml"))["project"]["version"]
    return [
        *_faults_of_version(root, version),
        *_faults_of_changelog(root, version, tag),
        *_faults_of_tag(version, tag),
    ]


def _text(root: Path, name: str) -> str:
    return (root / name).read_text(encoding="utf-8")


def _faults_of_version(root: Path, version: str) -> Iterator[str]:
    if not re.fullmatch(VERSION, version):
        yield f"pyproject.toml: the version {version!r} is not one such as 1.2.3 or 1.2.3rc1"
    for name, pattern in STATED.items():
        found = re.findall(pattern, _text(root, name), re.MULTILINE)
        if not found:
            yield f"{name}: it states no version; pyproject.toml has {version}"
        for other in sorted({*found} - {version}):
            yield f"{name}: it states the version {other}, pyproject.toml {version}; make them the same"


def _faults_of_changelog(root: Path, version: str, tag: str) -> Iterator[str]:
    sections = re.findall(r"^## \[(.*)\] - (.*)$", _text(root, "CHANGELOG.md"), re.MULTILINE)
    if not sections:
        yield "CHANGELOG.md: it has no section such as '## [1.2.3] - 2026-12-31'"
        return
    newest, released = sections[0]
    if newest != version:
        yield f"CHANGELOG.md: the first section is of version {newest}, pyproject.toml has {version}; add a section"
    if released != UNRELEASED and not _is_date(released):
        yield f"CHANGELOG.md: {released!r} is neither a date such as 2026-12-31 nor {UNRELEASED}"
    if not tag:
        return
    if released == UNRELEASED:
        yield f"CHANGELOG.md: version {newest} is {UNRELEASED}; write the date of the release in its place"
        return
    cited = re.findall(r"^date-released: (.*)$", _text(root, "CITATION.cff"), re.MULTILINE)
    if [date_of.strip("\"'") for date_of in cited] != [released]:
        stated = ", ".join(cited) or "none"
        yield f"CITATION.cff: date-released is {stated}; write the date of the changelog, {released}"


def _faults_of_tag(version: str, tag: str) -> Iterator[str]:
    if tag and tag != f"v{version}":
        yield f"the tag {tag} is not v{version}, the version in pyproject.toml"


def _is_date(text: str) -> bool:
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def main() -> None:
    """Print the faults, and exit with 1 if there are any."""
    if len(sys.argv) > 2:
        sys.exit("usage: release_check.py [TAG]")
    found = faults(Path(__file__).resolve().parents[1], *sys.argv[1:])
    if found:
        sys.exit("\n".join(found))
    print("the files of the release agree")


if __name__ == "__main__":
    main()
