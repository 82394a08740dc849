import json
import os
import subprocess
import sys

import numpy as np
import pytest

from liaam.fitting.equations import length
from liaam.kernels import machine_code
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double1

COUNT = """
import sys
import numpy as np
from liaam.fitting.equations import length
print(length(np.array([3.0, 4.0, 5.0]), 2), "numba" in sys.modules)
"""


def run(folder, code=COUNT, **environment) -> str:
    out = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)} | environment,
        capture_output=True,
        text=True,
    )
    assert out.returncode == 0, out.stderr
    return out.stdout.strip()


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("code")
    assert run(folder) == "5.0 True"
    return folder


def the_file(folder):
    (path,) = (folder / "liaam").iterdir()
    return path


def test_a_later_process_does_not_import_numba(kept):
    assert run(kept) == "5.0 False"


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "another head"])
def test_damaged_files_are_compiled_anew(kept, damage, tmp_path):
    data = the_file(kept).read_bytes()
    changed = {
        "cut": data[:-40],
        "changed": data[:-40] + bytes([data[-40] ^ 1]) + data[-39:],
        "empty": b"",
        "another head": b"[1]" + data[data.index(b"\n") :],
    }
    (tmp_path / "liaam").mkdir()
    (tmp_path / "liaam" / the_file(kept).name).write_bytes(changed[damage])
    assert run(tmp_path) == "5.0 True"
    assert run(tmp_path) == "5.0 False"


def test_other_settings_of_the_compiler_are_other_code(kept, tmp_path):
    (tmp_path / "liaam").mkdir()
    (tmp_path / "liaam" / the_file(kept).name).write_bytes(the_file(kept).read_bytes())
    assert run(tmp_path, NUMBA_BOUNDSCHECK="1") == "5.0 True"


def test_without_a_folder_to_write_to_code_is_compiled_each_time(tmp_path):
    (tmp_path / "liaam").write_bytes(b"")  # a file, where the folder would be
    assert run(tmp_path) == run(tmp_path) == "5.0 True"


def test_code_that_calls_what_the_process_lacks_is_compiled_anew(kept, tmp_path):
    head, _, binary = the_file(kept).read_bytes().partition(b"\n")
    about = json.loads(head) | {"calls": ["a_function_of_another_library"]}
    (tmp_path / "liaam").mkdir()
    (tmp_path / "liaam" / the_file(kept).name).write_bytes(json.dumps(about).encode() + b"\n" + binary)
    assert run(tmp_path) == "5.0 True"


def test_functions_of_the_process_and_of_linked_code_are_known():
    length(np.ones(2), 2)
    assert machine_code.is_known("sqrt")
    assert machine_code.is_known(length.symbol)
    assert not machine_code.is_known("a_function_of_another_library")


def test_a_function_calls_another_by_its_symbol():
    @compiled
    def twice(numbers: Double1) -> float:
        return 2.0 * length(numbers, len(numbers))

    assert twice(np.array([3.0, 4.0])) == 10.0
    assert twice.py_func(np.array([3.0, 4.0])) == 10.0
