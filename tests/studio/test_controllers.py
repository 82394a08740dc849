"""Controllers of the page own their fields: others ask them, or tell them what to do, by methods."""

import re

import pytest
from by_node import MODULES

WRITE = r"(?:\?\?|\|\||&&|[-+*/])?=(?![=>])"  # an assignment
GIVEN = "app|tab|state|marking|viewer|tool|saver|opening|commands|wall|sources|doc|drafting|tracing|shown"
ELEMENTS = "element|container|stage|canvas|video|controls|bar|splitter"  # of the page, that a class makes
OF_ELEMENTS = "dataset|style|firstChild|lastChild|value|dataTransfer|port1"  # such as text.style.left
# A field of what a module is given, of a part of it, or of a part of the own class.
FOREIGN = re.compile(
    rf"(?<![\w.#$])(?:(?:{GIVEN})\.\w+|(?!this|window|document|row)\w+\.(?!{OF_ELEMENTS})\w+\.[\w.]+"
    rf"|this\.(?!{ELEMENTS})\w+\.[\w.]+) {WRITE}|Object\.assign\((?:{GIVEN}|this\.(?!{ELEMENTS})\w+)\b"
)
CLASS = re.compile(r"^(?:export )?class (\w+)[^{]*\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
MAKES = {"main.js": "app."}  # what a module itself makes


@pytest.fixture(params=sorted(MODULES.glob("*.js")), ids=lambda path: path.name)
def module(request):
    return request.param


def test_a_module_writes_no_field_of_what_it_is_given(module):
    code = [line.split(" // ")[0].strip() for line in module.read_text().splitlines()]
    found = [line for line in code if FOREIGN.search(line)]
    assert [line for line in found if not line.startswith(MAKES.get(module.name, "\0"))] == []


def test_what_changes_in_an_object_is_private(module):
    text = module.read_text()
    assert re.findall(r"\.(_[a-z]\w*)", text) == []
    for name, body in CLASS.findall(text):
        written = re.findall(rf"\bthis\.(\w+) {WRITE}", body)
        declared = re.findall(r"^  (\w+) = ", body, re.MULTILINE)
        assert sorted([*written, *declared]) == sorted({*written, *declared}), name  # once, when it is made


@pytest.mark.parametrize(
    "line",
    [
        "tab.name = name;",
        "  this.view.others = [];",
        "tab.panel.edit.disabled = true;",
        "Object.assign(this.view, change);",
    ],
)
def test_such_writes_are_found(line):
    assert FOREIGN.search(line)


@pytest.mark.parametrize(
    "line", ["this.#name = name;", "this.name = name;", "text.value = tab.name;", "if (tab.name === x) go();"]
)
def test_others_are_not(line):
    assert not FOREIGN.search(line)
