"""Imports run downwards only, no module imports itself through others, and heavy imports wait until they are needed."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "liaam"

LAYERS = (
    ("__main__",),
    ("cli", "studio"),
    ("batch", "demo", "evaluation", "morphometry", "tracking"),
    ("plotting",),
    ("calibration",),
    ("registration", "relighting"),
    ("training",),
    ("fitting",),
    ("datasets", "drawing"),
    ("model",),
    ("photometry", "scale", "trays"),
    ("io",),
    ("error_measures", "models", "progress", "tables", "workers"),
    ("_core", "distance_transform", "encoding_constants", "formatting", "image_reference"),
    ("errors",),
)
"""Packages and modules of liaam from high to low. Those of one row do not import each other in a circle."""

FITTING_LAYERS = (
    ("many", "single", "solution", "specimens"),
    ("fitter",),
    ("low_quality",),
    ("damaged", "search"),
    ("fallback", "one_shape_fitter", "sides"),
    ("quality",),
    ("result",),
    ("loop",),
    ("reference",),
    ("detection", "landmarkers", "methods", "thresholds"),
)
"""The same for ``fitting``: its modules and the packages in it."""


def ranks(layers: tuple[tuple[str, ...], ...]) -> dict[str, int]:
    """Return the height of each unit, the lowest layer 1."""
    return {unit: len(layers) - i for i, row in enumerate(layers) for unit in row}


RANK = ranks(LAYERS)

FITTING_RANK = ranks(FITTING_LAYERS)


def module_of(path: Path) -> str:
    return ".".join(("liaam", *path.relative_to(SOURCE).with_suffix("").parts)).removesuffix(".__init__")


FILES = {module_of(path): path for path in sorted(SOURCE.rglob("*.py"))}


def is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def nodes_that_run(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those for type checkers only."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not is_for_types(child):
            yield from nodes_that_run(child)


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of liaam that a module imports, at its top or inside a function."""
    found = set()
    for node in nodes_that_run(ast.parse(FILES[module].read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in FILES else str(node.module) for name in names}
    return frozenset(name for name in found if name in FILES and name != module)


def unit_of(module: str) -> str:
    return module.split(".")[1]


UNITS = sorted(module for module in FILES if module != "liaam")


@pytest.mark.parametrize("layers", [LAYERS, FITTING_LAYERS], ids=["liaam", "fitting"])
def test_the_map_for_contributors_is_this_one(layers):
    text = (SOURCE.parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert "```\n" + "\n".join(map(", ".join, layers)) + "\n```" in text


def test_every_unit_has_a_layer():
    assert {unit_of(module) for module in UNITS} == set(RANK)


def test_imports_run_downwards():
    upward = [
        f"{module} imports {name} from above"
        for module in UNITS
        for name in imports(module)
        if name != "liaam" and RANK[unit_of(name)] > RANK[unit_of(module)]
    ]
    assert not upward, "\n".join(upward)


def test_what_a_fit_is_worth_has_one_door():
    door = "liaam.fitting.quality"
    outside = [module for module in UNITS if not module.startswith(door)]
    beside = [
        f"{module} imports {name}" for module in outside for name in imports(module) if name.startswith(f"{door}.")
    ]
    assert not beside, "\n".join(beside)


def fitting_unit_of(module: str) -> str:
    return module.split(".")[2]


FITTING = [module for module in UNITS if module.startswith("liaam.fitting.")]


def test_every_unit_of_fitting_has_a_layer():
    assert {fitting_unit_of(module) for module in FITTING} == set(FITTING_RANK)


def test_imports_run_downwards_in_fitting():
    upward = [
        f"{module} imports {name} from above"
        for module in FITTING
        for name in imports(module).intersection(FITTING)
        if FITTING_RANK[fitting_unit_of(name)] > FITTING_RANK[fitting_unit_of(module)]
    ]
    assert not upward, "\n".join(upward)
    assert not any("liaam.fitting" in imports(module) for module in FITTING)


def test_no_module_imports_itself_through_others():
    TopologicalSorter({module: imports(module) for module in FILES}).prepare()  # raises CycleError


def test_no_package_imports_itself_through_others():
    graph: dict[str, set[str]] = {}
    for module in UNITS:
        units = {unit_of(name) for name in imports(module) if name != "liaam"}
        graph.setdefault(unit_of(module), set()).update(units - {unit_of(module)})
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_all_names_of_the_reference_are_there_after_importing_liaam():
    text = "".join(page.read_text() for page in (SOURCE.parents[1] / "docs/reference/api").glob("*.rst"))
    names = re.findall(r"^   ([\w.]+)$", text, re.MULTILINE)
    assert len(names) > 100
    loaded_by(f"import liaam, operator; [operator.attrgetter(name)(liaam) for name in {names}]")


HEAVY = ("numpy", "scipy", "cv2", "matplotlib", "PIL", "typer", "safetensors", "rich", "av")


def loaded_by(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    environment = {"PYTHONPATH": str(SOURCE.parent)}
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return set(out.stdout.split())


def test_importing_liaam_imports_nothing_heavy():
    loaded = loaded_by("import liaam")
    assert "liaam" in loaded
    assert not loaded & set(HEAVY)
    assert not any(module.startswith("liaam.") for module in loaded)


def test_training_and_fitting_wait_for_what_is_slow_to_import():
    loaded = loaded_by("from liaam import train, Fitter")
    assert "liaam.fitting" in loaded
    assert not loaded & {"scipy", "matplotlib", "typer"}
    assert not any(module.startswith("liaam.calibration") for module in loaded)


def test_submodules_load_on_first_use():
    assert "liaam.batch.run" in loaded_by("import liaam; liaam.batch.run_batch")


@pytest.mark.parametrize("package", ["liaam", "liaam.calibration", "liaam.photometry", "liaam.plotting"])
def test_every_public_name_exists(package):
    module = import_module(package)
    names = getattr(module, "__all__", [name for name in dir(module) if not name.startswith("_")])
    for name in names:
        assert getattr(module, name) is not None
    assert set(names) <= set(dir(module))
    with pytest.raises(AttributeError, match=f"'{package}' has no attribute 'nonsense'"):
        module.nonsense  # noqa: B018
