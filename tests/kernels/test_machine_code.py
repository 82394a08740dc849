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


def begin(folder, code=COUNT, **environment) -> subprocess.Popen[str]:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)} | environment
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=pipe, stderr=pipe, text=True)


def end(process: subprocess.Popen[str]) -> str:
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    return out.strip()


def run(folder, code=COUNT, **environment) -> str:
    return end(begin(folder, code, **environment))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("code")
    assert run(folder) == "5.0 True"
    return folder


def the_file(folder):
    (path,) = (folder / "liaam").glob("*.o")
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


def test_processes_that_start_together_compile_once(tmp_path):
    assert sorted(map(end, [begin(tmp_path), begin(tmp_path)])) == ["5.0 False", "5.0 True"]


def test_a_suspended_process_does_not_stop_others(tmp_path):
    (tmp_path / "liaam").mkdir()
    code = COUNT.replace("print", "from liaam.kernels import machine_code; machine_code.PATIENCE = 0.1; print")
    with (tmp_path / "liaam" / "compiling.lock").open("ab") as file:
        pytest.importorskip("fcntl").flock(file, 2)  # exclusively
        assert run(tmp_path, code) == "5.0 True"


def test_code_is_complete_with_functions_of_the_process_and_of_linked_code():
    length(np.ones(2), 2)
    assert machine_code.is_complete(machine_code.Code("entry", ["sqrt", length.symbol], b""))
    assert not machine_code.is_complete(machine_code.Code("entry", ["a_function_of_another_library"], b""))
    assert not machine_code.is_complete(None)


def test_a_function_calls_another_by_its_symbol():
    @compiled
    def twice(numbers: Double1) -> float:
        return 2.0 * length(numbers, len(numbers))

    assert twice(np.array([3.0, 4.0])) == 10.0
    assert twice.py_func(np.array([3.0, 4.0])) == 10.0
