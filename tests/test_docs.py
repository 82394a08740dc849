"""The documentation: links between files of the repository hold, code names what exists, and the tutorial runs."""

import ast
import csv
import inspect
import pkgutil
import re
import shlex
import subprocess
import sys
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import typer

import liaam
from docs.figures import make_walk
from liaam import FitResult
from liaam.cli.main import app
from liaam.datasets import label_faults
from liaam.fitting.search import finder
from liaam.fitting.thresholds import THRESHOLDS
from liaam.io import video_writer
from liaam.io.images import VIDEO_SUFFIXES
from liaam.model.views import VIEWS
from liaam.relighting import Lamp, Relighter
from liaam.relighting.lamp import STRONGEST
from liaam.relighting.relighter import LONGEST
from liaam.tracking.files import arrays_of
from liaam.training import options
from liaam.training.lamps.bank import DARK, LearntLamps
from scenes.wing import PERIOD

ROOT = Path(__file__).resolve().parents[1]

BUILT = {"_build", "gallery", "generated"}
"""Folders below docs/ that the build of the site writes."""

PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "benchmarks/*.md", "experiments/**/*.md", "fuzz/*.md")
    for path in ROOT.glob(pattern)
    if not BUILT & set(path.relative_to(ROOT).parts)
)

LINK = re.compile(r"\]\(([^()\s]+)\)")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def blocks(path: Path, language: str) -> list[str]:
    return [code for kind, code in BLOCK.findall(text_of(path)) if kind == language]


def anchors(path: Path) -> set[str]:
    """Anchors of a page: its headings, as GitHub and MyST name them, and labels."""
    text = BLOCK.sub("", text_of(path))
    return headings(text) | set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


def headings(text: str) -> set[str]:
    """Anchors of headings."""
    found = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in found}


def test_links_between_files_hold():
    links = ((path, link) for path in PAGES for link in LINK.findall(BLOCK.sub("", text_of(path))))
    for path, link in links:
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), f"{path}: {link} does not exist"
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), f"{path}: {link}: there is no such heading"


def test_python_in_pages_names_what_exists():
    codes = ((path, code) for path in PAGES for code in blocks(path, "python"))
    for path, node in ((path, node) for path, code in codes for node in ast.walk(ast.parse(code))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("liaam"):
            module = import_module(str(node.module))
            for alias in node.names:
                assert hasattr(module, alias.name), f"{path}: {node.module} has no {alias.name}"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "liaam":
            assert hasattr(liaam, node.attr), f"{path}: liaam has no {node.attr}"


def options_of(words: list[str]) -> set[str]:
    """Options of a command that is written out, such as liaam camera chart A B --rows 4."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        assert words, "the command is not named"
        assert words[0] in command.commands, f"there is no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    return {name for parameter in command.params for name in parameter.opts} | {"--help"}


def test_commands_in_pages_have_these_options():
    codes = ((path, code.replace("\\\n", " ")) for path in PAGES for code in blocks(path, "sh"))
    for path, line in ((path, line) for path, code in codes for line in code.splitlines()):
        for part in re.split(r"&&|\|", line):
            words = shlex.split(part, comments=True)
            if words[:1] != ["liaam"] or words == ["liaam"]:
                continue
            known = options_of(words[1:])
            for word in words[1:]:
                if re.match(r"-{1,2}[a-z]", word):
                    assert word.partition("=")[0] in known, f"{path}: {line}: there is no {word}"


def words_of(path: Path) -> set[str]:
    return set(re.findall(r"\w+", text_of(path)))


def test_the_theory_names_code_that_exists():
    text = text_of(ROOT / "docs/explanation/theory.md")
    folders = [ROOT / name for name in ("src", "experiments", "scenes")]
    files = [path for folder in folders for path in folder.rglob("*.*") if path.suffix in (".py", ".cpp", ".hpp")]
    code = {path.relative_to(ROOT).as_posix(): words_of(path) for path in files}
    everywhere = set().union(*code.values())
    for name in re.findall(r"`([A-Za-z_][\w.]*)`", text):
        if not name.endswith((".py", ".cpp", ".hpp")):
            assert set(name.split(".")) <= everywhere, f"no code has {name}"
    for file, names in re.findall(r"`([\w/]+\.(?:py|[ch]pp))`(?::((?:,?\s+`[\w.]+`)+))?", text):
        words = [known for path, known in code.items() if f"/{path}".endswith(f"/{file}")]
        assert words, f"there is no {file}"
        for name in re.findall(r"[\w.]+", names):
            assert any(set(name.split(".")) <= known for known in words), f"{file} has no {name}"


# Words of which a text that cites an equation of the paper has one, within a line of the citation. The paper's eq 9 is
# eq 10 with one angle, which no code has alone; a shape with its mean, eq 1, is eq 2.
EQUATIONS = {
    2: r"shape|s\(p\)|mesh|vertices",
    3: r"warp|W\(x; p\)|dW|triangle|\bmesh\b",
    4: r"appearance|lambda|A_0|A0|modes",
    5: r"classical",
    6: r"\blogarithm|log",
    7: r"log rho|light-invariant|P\(theta_2\)",
    8: r"L\(theta|P\(theta_2\)|Row L|projection",
    9: r"10",
    10: r"theta_2|residual|cost|objective|Hessian|angle|step",
    11: r"[Ss]hadow|appearance|light",
}
CITED = re.compile(r"(?<!\d{4}, )\b[Ee]q\.? (\d+)(?:(?:-|–| and | to )(\d+))?")


def test_equations_are_cited_where_they_are():
    """Equation numbers of comments and docstrings are those of the paper, in C++ as in Python."""
    folders = [ROOT / name for name in ("src", "experiments", "scenes")]
    files = [path for folder in folders for path in folder.rglob("*.*") if path.suffix in (".py", ".cpp", ".hpp")]
    cited = set()
    for path in files:
        lines = path.read_text("utf-8").splitlines()
        for i, line in enumerate(lines):
            around = "\n".join(lines[max(i - 1, 0) : i + 2])
            for first, last in CITED.findall(line):
                for number in {int(first), int(last or first)}:
                    assert number in EQUATIONS, f"{path}:{i + 1}: the paper's equations that code has are 2 to 11"
                    assert last or re.search(EQUATIONS[number], around, re.IGNORECASE), (
                        f"{path}:{i + 1}: is this eq {number}?"
                    )
                    cited.add((number, path.suffix == ".py"))
            assert "DESIGN" not in line, f"{path}:{i + 1}: cites a file that is not in the repository"
    assert {number for number, _ in cited} >= {2, 3, 4, 6, 7, 8, 9, 10, 11}
    assert {number for number, python in cited if not python} >= {2, 3, 4, 6, 7, 8, 9, 10}


def test_links_of_the_readme_also_work_where_labels_do_not():
    for name, anchor in re.findall(r"\]\(([^():\s]+)#([^()\s]+)\)", text_of(ROOT / "README.md")):
        assert anchor in headings(text_of(ROOT / name)), f"{name}#{anchor} is no heading"


def test_the_arrays_of_a_track_are_described():
    section = text_of(ROOT / "docs/reference/output-files.md").partition("## Track of a video")[2]
    rows = re.findall(r"^\| (`.*?) \|", section.partition("\n## ")[0], re.MULTILINE)
    assert set(re.findall(r"`(\w+)`", " ".join(rows))) - {"index"} == set(arrays_of([], 5))


def public_classes() -> list[type]:
    """Data types of the API reference."""
    text = "".join(text_of(page) for page in (ROOT / "docs/reference/api").glob("*.rst"))
    names = re.findall(r"^   ([a-zA-Z_.]+)$", text, re.MULTILINE)
    found = [pkgutil.resolve_name(f"liaam:{name}" if "." not in name else f"liaam.{name}") for name in names]
    return [each for each in found if isinstance(each, type) and is_dataclass(each)]


def test_data_types_describe_their_fields_in_help_and_print_no_arrays():
    for kind, each in ((owner, each) for owner in public_classes() for each in fields(owner)):
        described = re.search(rf"^(\w+, )*{each.name}(, \w+)* : ", inspect.getdoc(kind) or "", re.MULTILINE)
        assert described or each.name.startswith("_"), f"{kind.__name__}.{each.name}"
        if each.type in ("np.ndarray", np.ndarray) and kind is not liaam.Registration:  # its matrix is small
            assert not hasattr(kind.__repr__, "__wrapped__"), f"{kind.__name__} prints {each.name}"


def test_data_types_refer_to_names_that_readers_can_look_up():
    for kind in public_classes():
        texts = [inspect.getdoc(kind), *(inspect.getdoc(each) for name, each in vars(kind).items() if name[0] != "_")]
        for name in re.findall(r":data:`(.*?)`", "\n".join(text or "" for text in texts)):
            assert name.startswith("liaam.") and pkgutil.resolve_name(name) is not None, f"{kind.__name__}: {name}"


def test_values_in_docstrings_are_those_of_the_code():
    blurs = " and ".join(f"{blurs} for the view ``{view}``" for view, blurs in options.BLURS.items())
    early = [THRESHOLDS[f"EARLY_{name}"] for name in ("EXPECTED", "EXPECTED_STEPS", "OWN", "OWN_STEPS")]
    expected, first, own, more = early
    for kind, text in (
        (liaam.TrainingOptions, f"at most {options.KEPT} for the view"),
        (liaam.TrainingOptions, f"Default: {blurs}"),
        (liaam.TrainingOptions, f"Default: {options.COPIES}, or 0"),
        (liaam.SolverOptions, f"{expected} in the first {first} steps"),
        (liaam.SolverOptions, f"{own} in the first {more}"),
        (liaam.SolverOptions, f"up to {THRESHOLDS['SCORING_STEPS']} such steps"),
        (liaam.find, f"up to {finder.MOST}."),
        (liaam.find, f"such as {finder.DOUBTFUL}."),
        (liaam.Detection.doubtful, f"below {finder.DOUBTFUL}."),
        (liaam.find_label_faults, f"fewer than {label_faults.LEAST_PICTURES} images"),
        (Lamp, f"0 to {STRONGEST:g}."),
        (Relighter.under, f"up to a factor {LONGEST}"),
        (LearntLamps, f"plus {DARK * 255:g}/255"),
        (video_writer, ", ".join(f"``{suffix}``" for suffix in VIDEO_SUFFIXES)),
        (liaam.AAM, ", ".join(f"``{name}``" for name in VIEWS)),
    ):
        assert " ".join(text.split()) in " ".join((inspect.getdoc(kind) or "").split()), text


def test_the_package_offers_its_public_names_only():
    assert {name for name in dir(liaam) if not name.startswith("__")} == {*liaam.__all__, *liaam._SUBMODULES}


@pytest.mark.parametrize("name", liaam._SUBMODULES)
def test_public_modules_list_nothing_that_they_import(name):
    module = import_module(f"liaam.{name}")
    for each in (each for each in dir(module) if not each.startswith("__")):
        value = getattr(module, each)
        home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", "liaam")
        assert home.split(".")[0] in ("liaam", "typing"), each  # a type such as Response is an alias


def test_a_fitter_lists_what_is_for_users():
    methods = {name for name in dir(liaam.Fitter(liaam.load_model("face"))) if not name.startswith("_")}
    assert methods - {each.name for each in fields(liaam.Fitter)} == {"find", "find_all", "fit", "fit_all", "of"}


def test_the_readme_is_short_and_says_how_to_install_and_test():
    text = text_of(ROOT / "README.md")
    assert len(text.splitlines()) <= 80
    assert "pip install . && liaam fit src/liaam/datasets/pictures/face/lisa.jpg" in text
    assert 'pip install -e ".[test]" && pytest -n logical' in text


def test_every_note_on_measurements_is_a_page_of_the_site():
    notes = {path.name for path in (ROOT / "experiments/notes").glob("*.md")}
    assert notes == {path.name for path in (ROOT / "docs/project/notes").glob("*.md")}


def test_every_example_has_its_place_in_the_gallery():
    listed = re.findall(r'"(plot_\w+\.py)"', text_of(ROOT / "docs/conf.py"))
    assert sorted(listed) == sorted(path.name for path in (ROOT / "examples").glob("*.py"))


PASTED = {
    "README.md": ("liaam-fits/lisa_fit.png", "lisa_relit.png", "new.pts"),
    "docs/tutorial/first-model.md": ("faces-model.png", "fits/photo.json", "new.pts", "new_flat.png"),
}
"""Pages whose blocks run when they are pasted in order, and some of the files that they write."""

SHOWN_FLIES = ("fly13", "fly14", "fly16", "fly19", "fly22", "fly27", "fly30")
"""Flies of the guide from a folder to a table that the test fits: the three with a torn wing, and others."""


def statements_of(page: str) -> list[str]:
    """Return what the blocks of a page do, in order: the commands of liaam, and Python without its comments."""
    found = []
    for kind, code in BLOCK.findall(text_of(ROOT / page)):
        if kind == "python":
            found += [ast.unparse(statement) for statement in ast.parse(code).body]
        if kind == "sh":
            lines = (shlex.split(line.removeprefix("pip install . && "), comments=True) for line in code.splitlines())
            found += [" ".join(words) for words in lines if words[:1] == ["liaam"]]
    return found


def test_the_landing_page_has_the_commands_and_the_code_of_the_readme():
    assert statements_of("docs/index.md") == statements_of("README.md")  # which run when they are pasted, below


@pytest.mark.slow
def test_commands_of_the_guide_from_a_folder_to_a_table_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    truth = make_walk.write_flies(tmp_path / "flies")
    for path in Path("flies/new").iterdir():  # the commands do the same for fewer flies
        if path.stem.rpartition("_")[0] not in SHOWN_FLIES:
            path.unlink()
    commands = make_walk.commands_of_guide()
    assert [words[0] for words in commands] == ["check", "train", "fit", "scale", "measure", "measure"]
    for words in commands:
        command = [sys.executable, "-m", "liaam", *make_walk.expanded(words)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0 or words[0] == "fit", done.stderr  # a torn wing may be doubtful
    with Path("table.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["specimen"]: row for row in csv.DictReader(file)}
    assert set(rows) == {f"{fly}_{side}" for fly in SHOWN_FLIES for side in ("left", "right")}
    usable = {name: row for name, row in rows.items() if row["status"] == "converged"}
    assert len(usable) >= len(rows) - 1
    assert all(name.endswith(row["side"]) for name, row in usable.items())
    whole = [name for name in usable if name not in make_walk.TORN]
    lengths = [float(usable[name]["distance_1_5_mm"]) for name in whole]
    true = [0.05 / PERIOD * np.linalg.norm(truth[name][0] - truth[name][4]) for name in whole]
    np.testing.assert_allclose(lengths, true, rtol=0.02)
    assert not any(usable[name]["distance_1_5_mm"] for name in make_walk.TORN if name in usable)
    assert Path("flies_anova.csv").exists() and Path("asymmetry.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("page", PASTED)
def test_code_and_commands_of_first_pages_run_when_they_are_pasted(tmp_path, monkeypatch, page):
    """All in order, as in a checkout; only the installation is left out."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "src").symlink_to(ROOT / "src")
    names: dict[str, object] = {}
    for kind, code in BLOCK.findall(text_of(ROOT / page)):
        if kind == "python":
            exec(code, names)
        for line in code.splitlines() if kind == "sh" else ():
            words = shlex.split(line.removeprefix("pip install . && "), comments=True)
            if words[:1] == ["liaam"]:
                subprocess.run([sys.executable, "-m", *words], check=True)
            else:
                assert words in ([], ["pip", "install", "."])
    result = names["result"]
    assert isinstance(result, FitResult)
    assert result.status == "converged"
    assert result.quality > 0.5
    assert all((tmp_path / name).exists() for name in PASTED[page])
