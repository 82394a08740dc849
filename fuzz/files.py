"""Other input files: lamps, starts, journals, summaries, tables of patches and sensitivities, lists."""

from __future__ import annotations

import json
import sqlite3
import tempfile
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fuzz import landmarks
from fuzz.mutate import LONGEST, NUMBERS, TEXTS, Random, one_of, spoilt, spoilt_json
from fuzz.target import Target
from liaam.errors import LiaamError

# Lamps --------------------------------------------------------------------------------------------

_ABOUT = {"format": "liaam-lamps", "schema": 1, "names": ["left", "right"]}


def _safetensors(tensors: dict[str, np.ndarray], about: Any) -> bytes:
    """Return a file of tensors with a header, which is JSON or made JSON."""
    from safetensors.numpy import save

    text = about if isinstance(about, str) else json.dumps(about)
    return save(tensors, {"liaam": text[:LONGEST]})  # safetensors limits the length of headers


_MEAN = np.array([[-0.4, -0.3], [0.4, -0.3], [0.0, 0.4]])
_LARGEST = 1e7  # of the numbers in the fields of a file: one of a gigabyte would take the fuzzer's own memory


@cache
def _lamps() -> bytes:
    """Return a lamp file without a fault."""
    return _safetensors({"mean": _MEAN, "fields": np.zeros((2, 128, 128, 3), np.float16)}, _ABOUT)


def make_lamps(rng: Random) -> bytes:
    """Corrupt a lamp file: its bytes, its header, or its tensors."""
    kind = rng.random()
    if kind < 0.3:
        words = (b'"mean"', b'"fields"', b'"F16"', b'"F64"', b'"BF16"', b'"data_offsets"', b"[0,0]")
        return spoilt(rng, [_lamps()], words)
    about = json.dumps(_ABOUT)
    if kind < 0.5:
        about = spoilt_json(rng, [_ABOUT]).decode("utf-8", "replace")
    mean = _MEAN
    if rng.random() >= 0.5:
        mean = rng.choice([0.0, 1.0, 1e-300, np.nan, np.inf], size=(int(rng.integers(5)), 2))
    shape = (2, 128, 128, 3)
    if rng.random() >= 0.75:
        shape = tuple(rng.choice([0, 1, 2, 3, 128], size=int(rng.integers(1, 5))))
    if np.prod(shape) > _LARGEST:
        shape = shape[:3]
    values = rng.choice([0.0, 1.0, -1.0, np.nan, np.inf, 6e4], p=[0.8, 0.06, 0.06, 0.02, 0.02, 0.04], size=2)
    fields = np.full(shape, values[0], one_of(rng, (np.float16, np.float16, np.float32, np.uint8)))
    return _safetensors({"mean": mean, "fields": fields}, about)


def check_lamps(data: bytes) -> None:
    """Load lamps. If accepted, relighting an image must work."""
    from liaam.training import load_lamps

    path = Path("x.lamps")
    path.write_bytes(data)
    lamps = load_lamps(path)
    points = np.random.default_rng(0).uniform(4, 28, (len(lamps.mean), 2))
    (lit,) = lamps.relit(np.full((32, 32, 3), 90, np.uint8), points, [len(lamps) - 1])
    assert lit.shape == (32, 32, 3) and lit.dtype == np.uint8


# Starts -------------------------------------------------------------------------------------------


def _number(rng: Random) -> str:
    """Return a number as text: an odd one, or a place in an image."""
    if rng.random() < 0.3:
        return one_of(rng, NUMBERS).decode("utf-8", "replace")
    return str(round(float(rng.normal(50, 60)), 1))


def make_start(rng: Random) -> tuple[str, bytes]:
    """Make the text of a start, and the content of a file of that name."""
    numbers = ",".join(_number(rng) for _ in range(int(rng.integers(2, 6))))
    kind = rng.random()
    if kind < 0.4:
        return numbers, b""
    if kind < 0.6:
        return "start.box", spoilt(rng, [b"1,2,30,40\n", b"5 6 70\n"], (b",", b" ", b"\n"))
    if kind < 0.7:
        return "start.box", numbers.encode()
    suffix = one_of(rng, (".pts", ".csv", ".ljson", ".xml", ".json"))
    if kind < 0.9:
        return f"start{suffix}", landmarks.make(suffix, rng)
    return one_of(rng, ("a" * 300, "x\0y", "", ".", "/", "/dev/zero", "/dev/null", "\udcff", "~", "*", *TEXTS)), b""


def check_start(given: tuple[str, bytes]) -> None:
    """Read a start as the command line does."""
    from liaam.fitting.search.starts import check_start, read_start

    text, data = given
    for path in Path().glob("start.*"):
        path.unlink()
    if data:
        Path(text).write_bytes(data)
    check_start(text)
    read_start(text, Path("x.png"), (640, 480))


# Journals and summaries of batches and experiments --------------------------------------------------------------

_FACTS = {"liaam": "0.1.0", "model": "ab", "method": "soft-li", "init": None, "camera": {"theta_deg": 122.0}}
# fmt: off
_COLUMNS = (
    "path", "object", "status", "message", "quality", "score", "n_found", "theta_deg", "cost", "iterations",
    "specimen", "code", "expansion", "landmarks", "covariance", "present", "side", "fingerprint",
    "scale", "scale_unit", "scale_from", "seconds",
)
# fmt: on
_ROW = {
    **dict.fromkeys(_COLUMNS),
    "path": "01.png",
    "specimen": "01#1",
    "code": "",
    "side": "",
    "fingerprint": "",
    "scale_unit": "",
    "scale_from": "",
    "status": "ok",
    "message": "",
    "quality": 0.9,
    "landmarks": [1.0, 2.0],
}


@cache
def _journal() -> bytes:
    """Return a journal without a fault, of five images of which two are finished."""
    from liaam.batch.journal import Journal

    with tempfile.TemporaryDirectory() as folder:
        with Journal(Path(folder) / "x.parts") as journal:
            journal.restart(_FACTS)
            journal.list([f"{i}.png" for i in range(5)], lambda path: None)
            for path, status in (("0.png", "converged"), ("1.png", "error")):
                journal.keep(journal.begin(path), (status, json.dumps(_ROW)))
        return (Path(folder) / "x.parts" / "journal.sqlite").read_bytes()


def make_journal(rng: Random) -> bytes:
    """Corrupt a batch's journal: its bytes, or its cells."""
    if rng.random() < 0.5:
        return spoilt(rng, [_journal()], (b"SQLite format 3\0", b"CREATE TABLE", b"pictures", b"facts", b"null"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.sqlite"
        path.write_bytes(_journal())
        with closing(sqlite3.connect(path)) as base:
            of_pictures = [("pictures", name) for name in ("place", "path", "state", "row", "status")]
            table, column = one_of(rng, [("facts", "text"), *of_pictures])
            values = (None, 7, 1.5, b"\xff\xfe", "", "{", "[]", "null", "x" * 10_000, json.dumps(_FACTS), b"", "a\0b")
            which = "WHERE rowid = 1" if rng.random() < 0.7 else ""
            if rng.random() < 0.6:
                value = one_of(rng, values)
            else:
                value = spoilt_json(rng, [_FACTS, _ROW]).decode("utf-8", "replace")
            try:
                base.execute(f"UPDATE OR REPLACE {table} SET {column} = ? {which}", (value,))
                base.execute("PRAGMA journal_mode = DELETE")
                base.commit()
            except (sqlite3.Error, UnicodeEncodeError):
                pass
        return path.read_bytes()


def check_journal(data: bytes) -> None:
    """Resume from it up to the table, as ``liaam batch`` does."""
    from liaam.batch.journal import Journal
    from liaam.batch.tables import BatchTable, row_of, write_table

    folder = Path("x.parts")
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    (folder / "journal.sqlite").write_bytes(data)
    with Journal(folder) as journal:
        _ = journal.facts, journal.statuses, journal.total
        journal.check()
        journal.list([f"{i}.png" for i in range(1, 6)], lambda path: None)
        for path in [*journal.suspects(), *journal.todo()]:
            journal.keep(journal.begin(path), ("error", json.dumps(_ROW)))
        rows = [(text, row) for text in journal.rows() if (row := row_of(text, 1, True)) is not None]
        if len(rows) < journal.total:
            raise journal.damage("a row")
        for suffix in (".csv", ".jsonl"):
            write_table(Path(f"x{suffix}"), BatchTable(rows, 1, True, _FACTS))
        journal.digest()


_SUMMARY = {"settings": _FACTS, "statuses": {"converged": 3, "error": 1}, "pictures": "ab", "bytes": 4}


def make_summary(rng: Random) -> bytes:
    """Corrupt the summary beside a table."""
    if rng.random() < 0.3:
        return spoilt(rng, [json.dumps(_SUMMARY).encode()], (b"[", b"{", b"null", b'"bytes"', b'"settings"'))
    return spoilt_json(rng, [_SUMMARY])


def check_summary(data: bytes) -> None:
    """Check whether a batch is complete, as when the same command is run again."""
    from liaam.batch.run import earlier_summary

    Path("x.csv").write_bytes(b"a,b\n")
    Path("x.csv.json").write_bytes(data)
    earlier = earlier_summary(Path("x.csv"))
    if earlier is None:
        raise LiaamError("none")
    assert sum(earlier["statuses"].values()) >= 0
    assert isinstance(earlier["settings"], dict)


_OUTCOME = {"key": "a", "rows": [{"x": 1, "y": "b"}], "fault": None}


def make_experiment(rng: Random) -> bytes:
    """Corrupt an experiment's journal."""
    lines = [json.dumps({**_OUTCOME, "key": key}).encode() for key in "abc"]
    lines = [spoilt_json(rng, [_OUTCOME]) if rng.random() < 0.3 else line for line in lines]
    return spoilt(rng, [b"\n".join([*lines, b""])], (b"\n", b"{", b"}", b'"key"'))


_LINE = json.dumps(_OUTCOME).encode() + b"\n"


def check_experiment(data: bytes) -> None:
    """Open it. The lines before a damaged one must be kept."""
    from experiments.runner import Journal

    path = Path("x.jsonl")
    path.write_bytes(data)
    with Journal(path) as journal:
        if not journal.outcomes:
            raise LiaamError("nothing is kept")
        assert all(isinstance(key, str) for key in journal.outcomes)
        assert all(isinstance(row, dict) for outcome in journal.outcomes.values() for row in outcome.rows)


# Tables and lists ---------------------------------------------------------------------------------

_PATCHES = (b"x0,y0,x1,y1\n1,2,3,4\n5,6,7,8\n", b"1,2,3,4\n")
_CELLS = (b",", b";", b"\t", b"\n", b'"', b"\xef\xbb\xbf", b"#")


def check_patches(data: bytes) -> None:
    """Read boxes of patches."""
    from liaam.cli.camera import patches_in

    path = Path("x.csv")
    path.write_bytes(data)
    assert patches_in(str(path)).shape[1] == 4


@cache
def _sensitivities() -> tuple[bytes, ...]:
    nm = np.arange(400, 701, 10)
    curves = np.stack([np.exp(-(((nm - middle) / 40.0) ** 2)) for middle in (600, 540, 450)], axis=1)
    rows = [f"{x},{r:.4f},{g:.4f},{b:.4f}" for x, (r, g, b) in zip(nm, curves, strict=True)]
    return ("\n".join(["# made by hand", "wavelength_nm,R,G,B", *rows]).encode(),)


def check_sensitivities(data: bytes) -> None:
    """Read a camera's sensitivities."""
    from liaam.calibration.spectral import read_sensitivities

    path = Path("x.csv")
    path.write_bytes(data)
    read_sensitivities(path)


def check_list(data: bytes) -> None:
    """List images, sort them as in a journal, and find each by name."""
    from liaam.batch import find_pictures, listed_pictures
    from liaam.batch.journal import Journal

    with Journal(Path("y.parts")) as journal:
        journal.list(listed_pictures(data.splitlines(keepends=True)), lambda name: None)
        listed = list(journal.todo())
        journal.remove()
    for path in listed[:3]:
        _ = list(find_pictures(path.lstrip("/").replace("..", "_") or "x"))


_LISTS = (b"01.png\nfolder/02.png\n./03.png\n", b"\xef\xbb\xbf1.png\r\n\r\n2.png")


def _prepare_list() -> None:
    """Make the files that the lists name, and read one of them."""
    for name in ("01.png", "1.png", "2.png", "folder/02.png"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).touch()
    check_list(_LISTS[1])


def _bytes(corpus: tuple[bytes, ...], words: tuple[bytes, ...], rng: Random) -> bytes:
    """Corrupt one of some files, with some words of its format; the generator is last, for :func:`partial`."""
    return spoilt(rng, corpus, words)


def _make_sensitivities(rng: Random) -> bytes:
    return spoilt(rng, _sensitivities(), (*_CELLS, b"wavelength_nm", b"R", b"400", b"-1"))


TARGETS = (
    Target("lamps", make_lamps, check_lamps, lambda: check_lamps(_lamps()), ".lamps", share=0.2),
    Target("start-files", make_start, check_start, lambda: check_start(("start.box", b"1,2,30")), ".txt"),
    Target("journals", make_journal, check_journal, lambda: check_journal(_journal()), ".sqlite", share=0.2),
    Target("summaries", make_summary, check_summary, lambda: check_summary(json.dumps(_SUMMARY).encode()), ".json"),
    Target(
        "experiment-journals", make_experiment, check_experiment, lambda: check_experiment(_LINE), ".jsonl", share=0.3
    ),
    Target(
        "patches",
        partial(_bytes, _PATCHES, _CELLS),
        check_patches,
        lambda: check_patches(_PATCHES[0]),
        ".csv",
        share=0.5,
    ),
    Target(
        "sensitivities",
        _make_sensitivities,
        check_sensitivities,
        lambda: check_sensitivities(_sensitivities()[0]),
        ".csv",
        share=0.3,
    ),
    Target(
        "lists",
        partial(_bytes, _LISTS, (b"\n", b"\r", b"/", b"./", b"1")),
        check_list,
        _prepare_list,
        ".txt",
        share=0.2,
    ),
)
