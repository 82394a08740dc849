"""The map of DESIGN section 2: imports run downwards only, and the heavy ones wait until they are needed."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "liaam"

LAYERS = (
    ("__main__",),
    ("cli", "studio"),
    ("demo", "batch", "tracking"),
    ("plotting", "plotting_photometry", "plotting_video"),
    ("calibration",),
    ("registration", "relighting"),
    ("training", "fitting"),
    ("model",),
    ("warp", "sampling", "appearance", "label_faults", "lamps"),
    ("bilinear",),
    ("mesh", "shape"),
    ("shape_prior",),
    ("pca",),
    ("datasets",),
    ("photometry",),
    ("io",),
    ("evaluation", "progress", "workers"),
    ("kernels",),
    ("errors", "jit"),
)
"""Units from high to low. Units of one row may import each other, but not in a circle."""

RANK = {unit: len(LAYERS) - i for i, row in enumerate(LAYERS) for unit in row}


def unit_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Units that a file imports, at its top or inside a function."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            modules |= (
                {f"{node.module}.{alias.name}" for alias in node.names} if node.module == "liaam" else {node.module}
            )
    names = {module.split(".")[1] for module in modules if module.startswith("liaam.")}
    return (names & ({p.stem for p in SOURCE.iterdir()} | set(RANK))) - {unit_of(path)}


FILES = sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")


def test_the_map_for_contributors_is_this_one():
    text = (SOURCE.parents[1] / "CONTRIBUTING.md").read_text()
    assert "```\n" + "\n".join(map(", ".join, LAYERS)) + "\n```" in text


def test_every_unit_has_a_layer():
    assert {unit_of(path) for path in FILES} <= set(RANK)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_run_downwards(path):
    upward = {unit for unit in imports(path) if RANK[unit] > RANK[unit_of(path)]}
    assert not upward, f"{unit_of(path)} imports {upward} from above"


def test_no_unit_imports_itself_through_others():
    graph: dict[str, set[str]] = {}
    for path in FILES:
        graph.setdefault(unit_of(path), set()).update(imports(path))
    TopologicalSorter(graph).prepare()  # raises CycleError


HEAVY = ("numpy", "numba", "scipy", "cv2", "matplotlib", "PIL", "typer", "safetensors", "rich", "av")


def loaded_by(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    environment = {"PYTHONPATH": str(SOURCE.parent)}
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return set(out.stdout.split())


def test_importing_liaam_imports_nothing_heavy():
    loaded = loaded_by("import liaam")
    assert "liaam" in loaded
    assert not loaded & set(HEAVY)
    assert not {module for module in loaded if module.startswith("liaam.")}


def test_training_and_fitting_wait_for_what_is_slow_to_import():
    loaded = loaded_by("from liaam import train, Fitter")
    assert "liaam.fitting" in loaded
    assert not loaded & {"numba", "scipy", "matplotlib", "typer"}
    assert not loaded & {f"liaam.photometry.{name}" for name in ("entropy", "masks", "radiometry", "spectral")}


@pytest.mark.parametrize("package", ["liaam", "liaam.photometry"])
def test_every_public_name_exists(package):
    module = import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError, match=f"'{package}' has no attribute 'nonsense'"):
        module.nonsense  # noqa: B018
