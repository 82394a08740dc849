"""Machine code of compiled functions: kept in files, and loaded without numba.

The files lie in the folder that ``NUMBA_CACHE_DIR`` names, else beside this module, or in the user's cache if that
cannot be written. A file is used only if its sources, the versions of the compilers, their settings and the processor
are still the same.
"""

import hashlib
import json
import os
import re
import secrets
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from time import monotonic, sleep
from typing import Any, BinaryIO, NamedTuple, TypeGuard

try:
    import fcntl
except ImportError:  # Windows: processes that start together compile the same functions
    fcntl: Any = None

import llvmlite
from llvmlite import binding

PATIENCE = 30.0
"""Seconds, from a process's first compilation on, in which it waits for others, since one of them may be suspended."""

_NOT_IN_NAMES = re.compile(r"[^\w.]+")


class Code(NamedTuple):
    """Machine code of a function."""

    entry: str
    """Name of the function in the object file."""
    calls: list[str]
    """Names of the functions that it calls, other than intrinsics."""
    binary: bytes
    """The object file."""


def find(symbol: str) -> Code | None:
    """Return the machine code that was kept for a function, None if there is none."""
    for folder in _folders():
        with suppress(OSError, ValueError, KeyError, TypeError):
            head, _, binary = (folder / _file_of(symbol)).read_bytes().partition(b"\n")
            about = json.loads(head)
            if about["state"] == _state() and about["digest"] == hashlib.sha256(binary).hexdigest():
                return Code(about["entry"], about["calls"], binary)
    return None


def keep(symbol: str, code: Code) -> None:
    """Keep the machine code of a function, in the first folder that can be written."""
    about = {"state": _state(), "digest": hashlib.sha256(code.binary).hexdigest()}
    head = json.dumps(about | {"entry": code.entry, "calls": code.calls}).encode()
    for folder in _folders():
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # Unlike a file of tempfile, it can be read by all who can read the folder.
            path = folder / f"{secrets.token_hex(8)}.tmp"
            try:
                path.write_bytes(head + b"\n" + code.binary)
                path.replace(folder / _file_of(symbol))
            finally:
                path.unlink(missing_ok=True)
            return


@contextmanager
def alone() -> Iterator[None]:
    """Wait until no other process compiles, so that processes that start together compile each function once."""
    with ExitStack() as stack:
        for folder in _folders() if fcntl is not None else ():
            with suppress(OSError):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                _lock(stack.enter_context((folder / "compiling.lock").open("ab")), stack)
                break
        yield


def _lock(file: BinaryIO, stack: ExitStack) -> None:
    """Lock a file until the stack's end, or give up after :data:`PATIENCE`."""
    deadline = _deadline()
    while True:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Closing the file is not enough: a process forked meanwhile has it open, too.
            stack.callback(fcntl.flock, file, fcntl.LOCK_UN)
            return
        if monotonic() > deadline:
            return
        sleep(0.01)


@lru_cache(1)
def _deadline() -> float:
    return monotonic() + PATIENCE


def is_complete(code: Code | None) -> TypeGuard[Code]:
    """Return whether there is code, and all that it calls: functions of the process, such as ``sqrt``, and of links."""
    _engine()  # makes those of the process known
    return code is not None and all(binding.address_of_symbol(name) is not None for name in code.calls)


def link(symbol: str, code: Code) -> int:
    """Load machine code, and return its address. Code that is loaded later may call it by its symbol."""
    engine = _engine()
    engine.add_object_file(binding.ObjectFileRef.from_data(code.binary))
    engine.finalize_object()
    address = engine.get_function_address(code.entry)
    if not address:
        raise RuntimeError(f"{symbol}: the compiled code was not found")
    binding.add_symbol(symbol, address)
    return address


@lru_cache(1)
def _engine() -> Any:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_triple(binding.get_process_triple()).create_target_machine(jit=True)
    return binding.create_mcjit_compiler(binding.parse_assembly(""), machine)


def _folders() -> Iterator[Path]:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        yield Path(chosen) / "liaam"
        return
    yield Path(__file__).with_name("__pycache__")
    with suppress(RuntimeError):  # there is no home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "liaam"


def _file_of(symbol: str) -> str:
    return f"{_NOT_IN_NAMES.sub('_', symbol)}.{_processor()[:8]}.o"


@lru_cache(1)
def _processor() -> str:
    about = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(), sys.platform
    return hashlib.sha256(repr(about).encode()).hexdigest()


@lru_cache(1)
def _state() -> str:
    """Digest of all that machine code depends on. A change of any module counts: code includes what it calls."""
    package = Path(__file__).parents[1]
    folders = ("fitting", "kernels", "model", "photometry")
    files = sorted(path for folder in folders for path in (package / folder).glob("*.py"))
    sources = [(str(path.relative_to(package)), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    settings = sorted((k, v) for k, v in os.environ.items() if k.startswith("NUMBA_") and k != "NUMBA_CACHE_DIR")
    versions = sys.version, version("numba"), llvmlite.__version__
    return hashlib.sha256(repr((sources, settings, versions, _processor())).encode()).hexdigest()
