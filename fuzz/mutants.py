"""Mutation testing: change one thing at a time in a module, and see whether its tests notice.

    python -m fuzz.mutants liaam.io.images --sample 200 --seed 1

Each mutant is tried in a forked process. One inside a function is put into a session of pytest whose tests have run
once, and only those that ran its line are run again. One outside (a constant, a default) is there before liaam is
imported, and all tests of the module are run.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import gc
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import time
import types
from collections import Counter
from collections.abc import Callable, Iterable
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import pytest

from fuzz.mutants_of import EQUIVALENT, PARTS, TESTS
from fuzz.mutations import Mutant, mutants_of

ROOT = Path(__file__).resolve().parents[1]
MEMORY = 3 * 2**30
"""Bytes that a mutant may take beyond what its parent has."""
HEAVY = ("numpy", "scipy.optimize", "scipy.spatial", "scipy.ndimage", "scipy.interpolate", "cv2", "PIL.Image",
         "PIL.ImageOps", "safetensors.numpy", "hypothesis", "typer", "rich.console", "h11", "starlette.applications",
         "uvicorn", "httpx", "coverage")  # fmt: skip
"""Imported once, before there are any mutants."""
TERMINAL = os.dup(1)
"""Where to print while pytest runs."""
QUIET = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:benchmark", "-p", "no:faulthandler",
         "-o", "tmp_path_retention_policy=failed"]  # fmt: skip


class Source:
    """A module's source, and its mutants."""

    def __init__(self, module: str, sample: int | None, seed: int, again: set[str] | None = None) -> None:
        base = ROOT / "src" / module.replace(".", "/")
        self.module = module
        self.path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
        text = self.path.read_text()
        self.tree, rows = ast.parse(text), text.splitlines()
        parts = PARTS.get(module)
        every = [mutant for mutant in mutants_of(self.tree) if parts is None or mutant.function in parts]
        known = {(line, change) for name, line, change, _ in EQUIVALENT if name == module}
        self.mutants = [m for m in every if (rows[m.line - 1].strip().partition("  #")[0], m.change) not in known]
        self.n_equivalent = len(every) - len(self.mutants)
        self.n_all = len(self.mutants)
        if again is not None:
            self.mutants = [m for m in self.mutants if f"{module} {m.change}" in again]
        if sample is not None and sample < len(self.mutants):
            self.mutants = random.Random(f"{seed} {module}").sample(self.mutants, sample)

    def code(self) -> types.CodeType:
        return compile(self.tree, str(self.path), "exec", dont_inherit=True)


def fork(work: Callable[[], int], limit: float) -> str:
    """Do some work in a child of at most so many seconds; "survived" if it gives 0."""
    child = os.fork()
    if not child:
        with contextlib.suppress(BaseException):
            os.setpgrp()
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(round(limit))
            size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
            os._exit(work())
        os._exit(1)
    status = os.waitpid(child, 0)[1]
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what its tests have started
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGALRM:
        return "timeout"
    return "survived" if status == 0 else "killed"


def told(source: Source, mutant: Mutant, fate: str) -> str:
    """Print a mutant that lives."""
    if fate in ("survived", "uncovered"):
        os.write(TERMINAL, f"  {fate} {source.module}:{mutant.line}  {mutant.change}\n".encode())
    return fate


class Session:
    """A plugin of pytest that runs the tests once, and then some of them for each mutant."""

    def __init__(self, sources: list[Source], coverage: Any, slowest: float) -> None:
        self.sources, self.coverage, self.slowest = sources, coverage, slowest
        self.failed = False
        self.found: dict[str, Any] = {"fates": {}, "missing": {}}

    def listchain(self) -> list[Any]:
        """Stand for a test to come that needs what all tests share."""
        return [self.session]

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed |= report.failed

    def pytest_runtestloop(self, session: Any) -> bool:
        self.session, self.items, self.seconds = session, {item.nodeid: item for item in session.items}, {}
        slow = set()
        for name in self.items:
            self.coverage.switch_context(name)
            begun, worked = time.perf_counter(), time.process_time()
            self._run(name)
            self.seconds[name] = time.perf_counter() - begun
            if time.process_time() - worked > self.slowest:
                slow.add(name)
            if self.failed:
                self.found["fault"] = f"{name} fails without any mutant"
                return True
        self.coverage.stop()
        self.found["seconds"] = sum(self.seconds.values())
        self.seconds = {name: seconds for name, seconds in self.seconds.items() if name not in slow}
        functions = [f for f in gc.get_objects() if isinstance(f, types.FunctionType)]
        caches = [c for c in gc.get_objects() if isinstance(c, functools._lru_cache_wrapper)]
        self.caches = [cache for cache in caches if str(cache.__module__).startswith("liaam")]
        gc.freeze()
        if fork(lambda: self._fail_again(list(self.seconds)), 60 + 10 * self.found["seconds"]) != "survived":
            self.found["fault"] = "the tests fail when they are run again"
            return True
        for source in self.sources:
            self._try_all(source, [f for f in functions if f.__code__.co_filename == str(source.path)])
        return True

    def _run(self, name: str) -> None:
        item = self.items[name]
        item.ihook.pytest_runtest_protocol(item=item, nextitem=self)

    def _try_all(self, source: Source, functions: list[types.FunctionType]) -> None:
        _, statements, _, missing, _ = self.coverage.analysis2(str(source.path))
        self.found["missing"][source.module] = (len(statements), missing)
        contexts = self.coverage.get_data().contexts_by_lineno(str(source.path))
        for i, mutant in enumerate(source.mutants):
            if not mutant.function:
                continue
            names = {name for line in mutant.lines for name in contexts.get(line, ()) if name in self.seconds}
            quick_first = sorted(names, key=lambda name: self.seconds[name])
            limit = 5 + 10 * sum(self.seconds[name] for name in names)
            work = functools.partial(self._fail_mutated, source, mutant, functions, quick_first)
            fate = fork(work, limit) if names else "uncovered"
            self.found["fates"][f"{source.module} {i}"] = told(source, mutant, fate)

    def _fail_mutated(
        self, source: Source, mutant: Mutant, functions: Iterable[types.FunctionType], names: list[str]
    ) -> int:
        mutant.apply()
        codes = _codes(source.code())
        for function in functions:
            code = codes.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
            if code is not None:
                _replace(function, code)
        for cache in self.caches:
            cache.cache_clear()
        return self._fail_again(names)

    def _fail_again(self, names: list[str]) -> int:
        for name in names:
            self._run(name)
            if self.failed:
                return 1
        return 0


def _replace(function: types.FunctionType, code: types.CodeType) -> None:
    """Give a function another code. A method that no longer calls super() has lost a free variable: make it anew."""
    had = function.__code__.co_freevars
    if code.co_freevars == had:
        function.__code__ = code
        return
    cells = dict(zip(had, function.__closure__ or (), strict=True))
    if "__class__" in cells and set(code.co_freevars) <= set(had):
        closure = tuple(cells[name] for name in code.co_freevars)
        new = types.FunctionType(code, function.__globals__, function.__name__, function.__defaults__, closure)
        setattr(cells["__class__"].cell_contents, function.__name__, new)


def _codes(code: types.CodeType) -> dict[tuple[str, int], types.CodeType]:
    inner = [const for const in code.co_consts if isinstance(const, types.CodeType)]
    found = {(code.co_qualname, code.co_firstlineno): code}
    return functools.reduce(lambda all_, one: all_ | _codes(one), inner, found)


def in_session(sources: list[Source], tests: list[str], slowest: float, to: Path) -> int:
    """Try the mutants of functions."""
    import coverage
    import cv2

    cv2.setNumThreads(0)  # threads do not survive a fork
    with Path(os.devnull).open("w") as null:
        os.dup2(null.fileno(), 1)
    measured = coverage.Coverage(data_file=None, config_file=False, include=[str(s.path) for s in sources])
    measured.start()
    session = Session(sources, measured, slowest)
    pytest.main([*QUIET, *tests], plugins=[session])
    to.write_text(json.dumps(session.found))
    return 0


class _Finder:
    """Imports one module from a changed tree."""

    def __init__(self, source: Source) -> None:
        self.source = source

    def find_spec(self, name: str, path: object = None, target: object = None) -> Any:
        if name != self.source.module:
            return None
        loader = SourceFileLoader(name, str(self.source.path))
        loader.get_code = lambda fullname: self.source.code()  # type: ignore[method-assign]
        places = [str(self.source.path.parent)] if self.source.path.name == "__init__.py" else None
        return importlib.util.spec_from_file_location(
            name, self.source.path, loader=loader, submodule_search_locations=places
        )


def before_import(source: Source, mutant: Mutant | None, tests: list[str]) -> int:
    """Try a mutant of what is run when its module is imported."""
    if mutant is not None:
        mutant.apply()
    sys.meta_path.insert(0, _Finder(source))  # type: ignore[arg-type]
    with Path(os.devnull).open("w") as null:
        os.dup2(null.fileno(), 1)
        os.dup2(null.fileno(), 2)
    return int(pytest.main([*QUIET, *tests]) != 0)


def try_group(sources: list[Source], tests: list[str], slowest: float) -> dict[str, Any]:
    """Try all mutants of modules that have the same tests."""
    to = Path(f"/tmp/liaam-mutants-{os.getpid()}.json")
    fork(lambda: in_session(sources, tests, slowest, to), 24 * 3600)
    found = json.loads(to.read_text())
    to.unlink()
    if "fault" in found:
        raise SystemExit(found["fault"])
    limit = 30 + 10 * found["seconds"]
    outside = [(s, i, mutant) for s in sources for i, mutant in enumerate(s.mutants) if not mutant.function]
    if outside and fork(lambda: before_import(sources[0], None, tests), limit) != "survived":
        raise SystemExit("the tests fail without any mutant")
    for source, i, mutant in outside:
        fate = fork(functools.partial(before_import, source, mutant, tests), limit)
        found["fates"][f"{source.module} {i}"] = told(source, mutant, fate)
    return found


def living(text: str) -> set[str]:
    """Read the mutants that lived in an earlier run: module and change."""
    lines = [line.split("  ", 2)[1:] for line in text.splitlines() if line.startswith(("  survived ", "  uncovered "))]
    return {f"{where.split()[1].partition(':')[0]} {change}" for where, change in lines}


def report(source: Source, found: dict[str, Any]) -> Counter[str]:
    """Print what became of a module's mutants."""
    fates = [found["fates"][f"{source.module} {i}"] for i in range(len(source.mutants))]
    count, (n_lines, missing) = Counter(fates), found["missing"][source.module]
    killed = count["killed"] + count["timeout"]
    share = f"{killed / len(fates):.1%}" if fates else "-"
    print(
        f"{source.module}: {killed} of {len(fates)} killed ({share}{interval(killed, len(fates))}; "
        f"{count['timeout']} by time), {source.n_all} in all, {source.n_equivalent} equivalent; "
        f"lines {n_lines - len(missing)} of {n_lines}, not run: {missing}",
        flush=True,
    )
    return Counter(killed=killed, tried=len(fates), lines=n_lines, run=n_lines - len(missing))


def interval(killed: int, tried: int) -> str:
    """Give the 95 % interval of Wilson."""
    if not tried:
        return ""
    z, p = 1.96, killed / tried
    middle, half = p + z * z / (2 * tried), z * (p * (1 - p) / tried + z * z / (4 * tried**2)) ** 0.5
    low, high = ((middle + sign * half) / (1 + z * z / tried) for sign in (-1, 1))
    return f", 95 % of {low:.1%} to {high:.1%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="+", help="modules, or packages for all below them")
    parser.add_argument("--sample", type=int, help="so many mutants of each module; all if left out")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument(
        "--slowest", type=float, default=0.5, help="processor seconds above which a test is not used for functions"
    )
    parser.add_argument("--at-least", type=float, default=0.0, help="percent killed below which the exit status is 1")
    parser.add_argument("--again", type=Path, metavar="FILE", help="only those that lived in the run that printed FILE")
    asked = parser.parse_args()
    again = None if asked.again is None else living(asked.again.read_text())
    for name in ("OPENBLAS", "OMP"):  # threads do not survive a fork
        os.environ[f"{name}_NUM_THREADS"] = "1"
    os.chdir(ROOT)
    for name in HEAVY:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    wanted = [m for m in TESTS if any(m == name or m.startswith(f"{name}.") for name in asked.modules)]
    if not wanted:
        raise SystemExit(f"no such module: there are {', '.join(TESTS)}")
    total: Counter[str] = Counter()
    for tests in dict.fromkeys(TESTS[module] for module in wanted):
        sources = [Source(m, asked.sample, asked.seed, again) for m in wanted if TESTS[m] == tests]
        found = try_group(sources, list(tests), asked.slowest)
        for source in sources:
            total += report(source, found)
    killed, tried = total["killed"], total["tried"]
    print(f"all: {killed} of {tried} killed ({killed / max(tried, 1):.1%}{interval(killed, tried)}), "
          f"lines {total['run']} of {total['lines']}")  # fmt: skip
    raise SystemExit(killed < asked.at_least / 100 * tried)


if __name__ == "__main__":
    main()
