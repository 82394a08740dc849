"""Files of lamps: what is written comes back; what is broken is refused by name."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from liaam.errors import LiaamError
from liaam.model.light_basis import SIDE
from liaam.training.lamps import LearntLamps, load_lamps

MEAN = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, 0.5]])
HEADER = {"format": "liaam-lamps", "schema": 1, "names": ["left"]}


def fields(n: int = 1) -> np.ndarray:
    return np.zeros((n, SIDE, SIDE, 3), np.float16)


def write(folder: Path, header: object = None, **tensors: np.ndarray | None) -> Path:
    text = header if isinstance(header, str) else json.dumps(HEADER if header is None else header)
    whole = {"mean": MEAN, "fields": fields()} | tensors
    path = folder / "heads.lamps"
    path.write_bytes(save({key: value for key, value in whole.items() if value is not None}, {"liaam": text}))
    return path


def complaint(path: Path) -> str:
    with pytest.raises(LiaamError) as caught:
        load_lamps(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value).removeprefix(f"{path}: ")


def test_lamps_come_back_as_they_were_saved(tmp_path):
    lit = fields(2)
    lit[1, 3, 4] = (0.5, -0.25, 1.0)
    LearntLamps(MEAN, lit, ("left", "größer")).save(tmp_path / "heads.lamps")
    loaded = load_lamps(str(tmp_path / "heads.lamps"))
    assert loaded.names == ("left", "größer")
    np.testing.assert_array_equal(loaded.mean, MEAN)
    np.testing.assert_array_equal(loaded.fields, lit)
    assert (len(loaded), repr(loaded)) == (2, "LearntLamps(2 lamps, 3 landmarks)")


@pytest.mark.parametrize(
    "header",
    [
        "",
        "{",
        "[" * 100_000,
        "3",
        "[]",
        {**HEADER, "format": "liaam-aam"},
        {**HEADER, "schema": 2},
        {"names": ["left"]},
    ],
)
def test_files_of_another_kind_are_refused(tmp_path, header):
    assert complaint(write(tmp_path, header)) == (
        "this file contains no lamps; make one with 'liaam lamps FOLDER -o LAMPS'"
    )


def test_what_is_no_file_is_refused(tmp_path):
    make = "; make one with 'liaam lamps FOLDER -o LAMPS'"
    assert complaint(tmp_path) == f"the lamp file is a folder{make}"
    assert complaint(tmp_path / "none") == f"the lamp file does not exist{make}"
    assert complaint(Path("/dev/null")) == f"the lamp file is not a regular file{make}"
    (tmp_path / "text").write_text("hello, this is no safetensors file at all")
    assert "this is not a complete lamp file (" in complaint(tmp_path / "text")


@pytest.mark.parametrize(
    "tensors",
    [
        {"mean": np.where(np.arange(6).reshape(3, 2) == 1, 1.0, 0.0)},
        {"mean": -np.ones((3, 2))},
        {"mean": np.zeros((4, 2))},
    ],
)
def test_lamps_at_the_limits_are_taken(tmp_path, tensors):
    np.testing.assert_array_equal(load_lamps(write(tmp_path, **tensors)).mean, tensors["mean"])


@pytest.mark.parametrize(
    "changes",
    [
        {"mean": None},
        {"fields": None},
        {"mean": MEAN.astype(np.float32)},
        {"mean": MEAN.ravel()},
        {"mean": np.zeros((3, 3))},
        {"mean": np.zeros((3, 2, 2))},
        {"mean": MEAN[:2]},
        {"mean": MEAN + 0.501},
        {"mean": MEAN - 0.501},
        {"mean": MEAN * np.nan},
        {"fields": fields().astype(np.float32)},
        {"fields": fields()[:, 1:]},
        {"fields": fields()[:, :, 1:]},
        {"fields": fields()[..., :2]},
        {"fields": fields()[0]},
        {"fields": fields() + np.float16(np.nan)},
        {"fields": fields() + np.float16(np.inf)},
        {"fields": fields(0), "header": {**HEADER, "names": []}},
        {"fields": fields(2)},
        {"header": {**HEADER, "names": ["left", "right"]}},
        {"header": {**HEADER, "names": [7]}},
        {"header": {**HEADER, "names": "x"}},
        {"header": {**HEADER, "names": {"left": 1}}},
        {"header": {"format": "liaam-lamps", "schema": 1}},
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path, changes):
    assert complaint(write(tmp_path, **changes)) == ("the lamp file contradicts itself; copy it again or make it again")


@pytest.mark.parametrize(("n", "taken"), [(2, True), (3, False)])
def test_the_number_of_lamps_is_limited(tmp_path, monkeypatch, n, taken):
    monkeypatch.setattr("liaam.training.lamps.bank.MOST", 2)
    path = write(tmp_path, {**HEADER, "names": ["a"] * n}, fields=fields(n))
    if taken:
        assert len(load_lamps(path)) == n
    else:
        assert "contradicts itself" in complaint(path)


@pytest.mark.parametrize(
    ("fault", "reason"), [(OSError(5, "Input/output error"), "Input/output error"), (OSError("odd"), "odd")]
)
def test_a_file_that_cannot_be_read_says_why(tmp_path, monkeypatch, fault, reason):
    def broken(*_, **__):
        raise fault

    path = write(tmp_path)
    monkeypatch.setattr("safetensors.safe_open", broken)
    assert complaint(path) == f"the lamp file cannot be read ({reason}); check its permissions"


def test_a_file_without_a_header_is_refused(tmp_path):
    path = tmp_path / "heads.lamps"
    path.write_bytes(save({"mean": MEAN, "fields": fields()}))
    assert "contains no lamps" in complaint(path)


@pytest.mark.parametrize("dtype", ["BF16", "F8_E4M3"])
def test_types_that_numpy_lacks_are_refused(tmp_path, dtype):
    n_bytes = 12 if dtype == "BF16" else 6
    values = fields().tobytes()
    about = {
        "__metadata__": {"liaam": json.dumps(HEADER)},
        "mean": {"dtype": dtype, "shape": [3, 2], "data_offsets": [0, n_bytes]},
        "fields": {"dtype": "F16", "shape": [1, SIDE, SIDE, 3], "data_offsets": [n_bytes, n_bytes + len(values)]},
    }
    text = json.dumps(about).encode()
    path = tmp_path / "heads.lamps"
    path.write_bytes(len(text).to_bytes(8, "little") + text + bytes(n_bytes) + values)
    assert "this is not a complete lamp file (" in complaint(path)


def test_large_tensors_of_a_wrong_shape_are_not_read(tmp_path):
    n_bytes = 2 * 4 * SIDE**3
    about = {
        "__metadata__": {"liaam": json.dumps(HEADER)},
        "mean": {"dtype": "F64", "shape": [1, 2], "data_offsets": [0, 16]},
        "fields": {"dtype": "F16", "shape": [4, SIDE, SIDE, SIDE], "data_offsets": [16, 16 + n_bytes]},
    }
    text = json.dumps(about).encode()
    path = tmp_path / "heads.lamps"
    with path.open("wb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        file.truncate(8 + len(text) + 16 + n_bytes)
    tracemalloc.start()
    try:
        assert "contradicts itself" in complaint(path)
        assert tracemalloc.get_traced_memory()[1] < n_bytes / 4
    finally:
        tracemalloc.stop()
