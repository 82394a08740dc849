"""Docs, docstrings and messages use the words of the field: a list of words that readers stumbled over stays empty."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

COINED = (
    r"(?:is|are|was|were|be|been|who|not|has|have) told",
    r"tells? (?:apart|nothing|that|how|what|which|whether|us)",
    r"mend(?:s|ed|ing)?",
    r"noughts?",
    r"(?:bears?|bore|borne) (?:it )?out",
    r"vouch(?:es|ed)?",
    r"gainsay",
    r"heed(?:s|ed)?",
    r"whoever",
    r"hearsay",
    r"strangeness",
    r"comes? to little",
    r"says? nothing",
    r"say so little",
    r"nobody (?:can|has|knows|asks|asked)",
    r"not to be had",
    r"of (?:its|their) own accord",
    r"slip of the pen",
    r"for want of",
    r"(?<!there )is no (?:image|model|picture|number|shape|file|camera|start|folder|method|such)",
    r"(?:was|were|is|are|be) begun",
    r"understated",
    r"hurry",
)
"""Expressions that the field does not use, or that must be read twice; CONTRIBUTING.md says what to write instead."""

PATTERN = re.compile(r"\b(?:" + "|".join(COINED) + r")\b", re.IGNORECASE)

TEXTS = sorted(
    path
    for folder, suffixes in (
        ("src/liaam", {".py", ".js", ".html"}),
        ("docs", {".md", ".rst", ".py"}),
        ("examples", {".py"}),
        (".", {".md"}),
    )
    for path in ((ROOT / folder).glob("*") if folder == "." else (ROOT / folder).rglob("*"))
    if path.suffix in suffixes and "_build" not in path.parts and "vendor" not in path.parts
)


def test_no_coined_words():
    lines = ((path, n, line) for path in TEXTS for n, line in enumerate(path.read_text("utf-8").splitlines(), 1))
    found = [f"{path.relative_to(ROOT)}:{n}: {line.strip()}" for path, n, line in lines if PATTERN.search(line)]
    assert len(TEXTS) > 300
    assert not found, "\n".join(found)
