"""Command line: ``python -m fuzz.faults [NAME...] [--kills N] [--seed S]``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np

from fuzz.faults.commands import Kind, World, fresh, kinds, make_world
from fuzz.faults.studio import StudioSaves
from fuzz.faults.victim import of_command

TOLD = 30.0
"""Seconds between two lines on how far it is."""


def parser() -> argparse.ArgumentParser:
    """What can be said on the command line."""
    names = ", ".join(kind.name for kind in all_kinds())
    made = argparse.ArgumentParser(prog="python -m fuzz.faults", description="Kill commands at random moments.")
    made.add_argument("names", nargs="*", metavar="NAME", help=f"what is killed: {names}; all if left out")
    made.add_argument("--kills", type=int, default=50, help="of all kinds together (50)")
    made.add_argument("--seed", type=int, default=0, help="another seed gives other moments (0)")
    return made


def all_kinds() -> tuple[Kind | StudioSaves, ...]:
    """All kinds of work that are killed."""
    return (*kinds(), StudioSaves())


def warmed(folder: Path) -> World:
    """Make the world, and import and compile here, once, what the commands need."""
    import cv2

    cv2.setNumThreads(1)  # threads do not live on in a process that is forked
    world = make_world(folder)
    room = fresh(folder / "warm")
    for kind in kinds():
        arguments = kind.arguments(world, room)
        if "train" in arguments:
            arguments = ["train", str(world.pictures), "-o", str(world.model), *arguments[4:]]
        if "2" not in arguments:
            _run_here(arguments)
    import liaam.studio.app
    import liaam.studio.serving

    liaam.studio.serving._uvicorn()
    return world


def _run_here(arguments: list[str]) -> None:
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        of_command(arguments)()


def main(arguments: list[str]) -> int:
    """Kill what is asked for; 1 if anything was lost."""
    asked = parser().parse_args(arguments)
    chosen = [kind for kind in all_kinds() if not asked.names or kind.name in asked.names]
    unknown = set(asked.names) - {kind.name for kind in chosen}
    if unknown:
        print(f"no {', '.join(sorted(unknown))}; there are {', '.join(kind.name for kind in all_kinds())}")
        return 2
    failures = 0
    with tempfile.TemporaryDirectory(prefix="liaam-faults-") as folder:
        world = warmed(Path(folder))
        for i, kind in enumerate(chosen):
            n_kills = asked.kills * (i + 1) // len(chosen) - asked.kills * i // len(chosen)
            failures += _kill(kind, world, Path(folder), n_kills, asked.seed)
    return 1 if failures else 0


def _kill(kind: Kind | StudioSaves, world: World, room: Path, n_kills: int, seed: int) -> int:
    """Kill one kind of work so many times; gives the number of trials that failed."""
    begun, kills, trials, failures = time.monotonic(), 0, 0, 0
    told = begun
    kind.measure(world, room)
    spent = f"{kind.seconds:.2f} s, in a new interpreter {kind.seconds_anew:.2f} s"
    print(f"{kind.name}: undisturbed {spent}, {kind.writes} writes", flush=True)
    while kills < n_kills:
        rng = np.random.default_rng([seed, zlib.crc32(kind.name.encode()), trials])
        try:
            kills += kind.trial(world, room, rng, n_kills - kills)
        except AssertionError as fault:
            failures += 1
            print(f"{kind.name}, seed {seed}, trial {trials}: {fault}", flush=True)
            kills += 1
        trials += 1
        if time.monotonic() - told > TOLD:
            told = time.monotonic()
            print(f"{kind.name}: {kills} kills so far", flush=True)
    seconds = time.monotonic() - begun
    print(f"{kind.name}: {kills} kills in {trials} trials, {failures} failed, {seconds:.0f} s", flush=True)
    return failures


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
