"""The tool for mutation testing: what it changes, what it leaves alone, and that it tells life from death."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.mutants import Source, interval, living
from fuzz.mutants_of import EQUIVALENT
from fuzz.mutations import mutants_of

ROOT = Path(__file__).resolve().parents[1]

SOURCE = '''
"""A module."""

from os import path

LIMIT = 3


@decorated(1)
def check(text: str = "", most: "int | None" = 7) -> bool:
    """Docstring."""
    if len(text) > LIMIT and not text:
        raise ValueError(f"{text} is too long: {1 + 1} words at most")
    try:
        found.value = text[:2]
    except (KeyError, OSError):
        return None
    log(text, most)
    return "a sentence of words"
'''


def changes(source: str) -> list[str]:
    return [mutant.change for mutant in mutants_of(ast.parse(source))]


def test_what_is_changed():
    assert changes(SOURCE) == [
        "3 -> 4",
        "'' -> 'XX'",
        "7 -> 8",
        "len(text) > LIMIT and (not text) -> len(text) > LIMIT or not text",
        "len(text) > LIMIT and (not text) -> not text",
        "len(text) > LIMIT and (not text) -> len(text) > LIMIT",
        "len(text) > LIMIT -> len(text) >= LIMIT",
        "len(text) > LIMIT -> len(text) <= LIMIT",
        "not text -> text",
        "raise ValueError(f'{text} is too long: {1 + 1} words at most') -> pass",
        "1 + 1 -> 1 - 1",
        "1 -> 2",
        "1 -> 2",
        "found.value = text[:2] -> pass",
        "2 -> 3",
        "except (KeyError, OSError): return None -> except (KeyError, OSError): raise",
        "(KeyError, OSError) -> (OSError,)",
        "(KeyError, OSError) -> (KeyError,)",
        "log(text, most) -> pass",
        "log(text, most) -> log(most, text)",
        "return 'a sentence of words' -> return None",
    ]


def test_each_mutant_is_one_change_that_compiles():
    for i, mutant in enumerate(mutants_of(ast.parse(SOURCE))):
        tree = ast.parse(SOURCE)
        before = ast.unparse(tree)
        mutants_of(tree)[i].apply()
        assert ast.unparse(tree) != before
        compile(tree, "module.py", "exec")
        assert mutant.lines.start <= mutant.line < mutant.lines.stop


def test_constants_and_defaults_belong_to_no_function():
    where = {mutant.change: mutant.function for mutant in mutants_of(ast.parse(SOURCE))}
    assert where["3 -> 4"] == where["7 -> 8"] == ""
    assert where["2 -> 3"] == "check"
    nested = "class A:\n    def f(self):\n        def g(x=1):\n            return x + 2\n        return g"
    assert {mutant.function for mutant in mutants_of(ast.parse(nested))} == {"A.f"}


@pytest.mark.parametrize(("killed", "tried", "text"), [(0, 0, ""), (90, 100, ", 95 % of 82.6% to 94.5%")])
def test_the_interval_of_a_share(killed, tried, text):
    assert interval(killed, tried) == text


def test_mutants_that_no_test_could_kill_are_there():
    for module in {name for name, *_ in EQUIVALENT}:
        listed = [entry for entry in EQUIVALENT if entry[0] == module]
        assert Source(module, None, 1).n_equivalent >= len(listed), f"a line of {module} was changed: {listed}"


def test_the_living_are_read_from_a_report():
    report = "  survived liaam.io.pts:7  1 -> 2\n  uncovered liaam.io.tem:9  a  b -> c\nliaam.io.pts: 3 of 4 killed\n"
    assert living(report) == {"liaam.io.pts 1 -> 2", "liaam.io.tem a  b -> c"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="mutants are tried in forked processes, and their memory is read")
def test_mutants_of_a_module_are_killed():
    command = [sys.executable, "-m", "fuzz.mutants", "liaam.io.results", "--sample", "8", "--at-least", "50"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "of 8 killed" in done.stdout
