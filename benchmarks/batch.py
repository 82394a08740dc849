"""Speed, memory, and recovery from kills of ``liaam batch``, and its agreement with a cluster.

Generated portraits of 160×120 pixels, some linked under many names, are fitted by ``grey`` from one common start in a
few iterations. The fits are short, so that the cost of the batch itself is visible. The commands run in separate
processes, as for a user.
"""

import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from benchmarks.metrics import report
from liaam.io import write_image
from liaam.model.shape import diagonal_of
from liaam.training import train
from scenes import Head, make_set

SIZE = (160, 120)
DISTINCT = 200
SPEEDUP_BAR, GROWTH_BAR = 1.8, 10.0
PORT = 18787


@dataclass(frozen=True)
class Cost:
    """Cost of a batch: time and processor time in seconds, and peak memory of all its processes in MB."""

    seconds: float
    processor: float
    memory: float


class World:
    """A model, images under many names, and the command that fits them."""

    def __init__(self, folder: Path, distinct: int) -> None:
        self.folder = folder
        scenes = make_set(distinct, Head(5), size=SIZE, seed=2)
        pairs = [(scene.image, scene.landmarks) for scene in scenes[:6]]
        model = train(pairs, diagonal=60.0, leave_out=False, lamps=None, methods=["grey"])
        model.save(folder / "model.liaam")
        shape = np.mean([scene.landmarks for scene in scenes], axis=0)
        x, y = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
        self.init = f"{x:.0f},{y:.0f},{diagonal_of(shape):.0f}"
        self.originals = [folder / f"{i}.png" for i in range(distinct)]
        for path, scene in zip(self.originals, scenes, strict=True):
            write_image(path, scene.image)

    def pictures(self, n: int) -> Path:
        """Return a folder with `n` names."""
        folder = self.folder / f"images{n}"
        if not folder.exists():
            folder.mkdir()
            for i in range(n):
                os.link(self.originals[i % len(self.originals)], folder / f"{i}.png")
        return folder

    def start(self, n: int, output: str, *options: object) -> psutil.Popen:
        """Start a batch."""
        command: list[object] = [sys.executable, "-m", "liaam", "batch", self.folder / "model.liaam", self.pictures(n)]
        command += ["-o", self.folder / output, "-m", "grey", "--init", self.init, *options]
        return psutil.Popen([str(part) for part in command], stdout=subprocess.DEVNULL)

    def run(self, n: int, output: str, *options: object) -> "Cost":
        """Run a batch, including the start of its process."""
        begin, before = time.perf_counter(), processor_seconds()
        most = watch(self.start(n, output, *options))
        return Cost(time.perf_counter() - begin, processor_seconds() - before, most)

    def rows(self, output: str) -> list[list[str]]:
        """Rows of a table without the last column, the seconds."""
        with (self.folder / output).open(newline="") as file:
            return [row[:-1] for row in csv.reader(file)]


def processor_seconds() -> float:
    """Processor time of all ended child processes, in seconds."""
    times = os.times()
    return times.children_user + times.children_system


def watch(process: psutil.Popen) -> float:
    """Wait for a batch and return its peak memory, in MB."""
    most = 0
    while process.poll() is None:
        most = max(most, memory(process))
        time.sleep(0.1)
    if process.returncode:
        raise RuntimeError(f"a batch has failed, with status {process.returncode}")
    return most / 1e6


def memory(process: psutil.Popen) -> int:
    """Resident memory of a process and its children in bytes; 0 if one has just ended."""
    try:
        return sum(one.memory_info().rss for one in [process, *process.children(recursive=True)])
    except psutil.Error:
        return 0


def measure_speed(world: World, n: int) -> None:
    """Measure the rate of one thread and of two. The difference of two runs excludes the start of the process.

    Two parallel batches of one process each measure the gain that the machine allows.
    """
    few, seconds, processor = max(1, n // 10), {}, {}
    for jobs in (1, 2):
        long, short = (world.run(count, f"speed{jobs}_{count}.csv", "--jobs", jobs) for count in (n, few))
        seconds[jobs] = (long.seconds - short.seconds) / (n - few)
        processor[jobs] = (long.processor - short.processor) / (n - few)
        report(f"batch_rate_{jobs}", 1 / seconds[jobs], f"pictures a second, {n - few} of them", form=".1f")
        report(f"batch_processor_ms_{jobs}", 1e3 * processor[jobs], "for each picture", form=".1f")
    apart = (side_by_side(world, n) - side_by_side(world, few)) / (2 * (n - few))
    report("batch_rate_apart", 1 / apart, "pictures a second by two batches of one process each", form=".1f")
    report("batch_speedup", seconds[1] / seconds[2], f"(bar: at least {SPEEDUP_BAR})", form=".2f")
    report("batch_speedup_apart", seconds[1] / apart, "of the machine itself", form=".2f")


def side_by_side(world: World, n: int) -> float:
    """Time of two parallel batches with one process each, in seconds."""
    begin = time.perf_counter()
    batches = [world.start(n, f"apart{i}_{n}.csv", "--jobs", 1) for i in range(2)]
    for process in batches:
        process.wait()
    return time.perf_counter() - begin


def measure_memory(world: World, n: int) -> None:
    """Measure the memory for a tenth of the images, and for all."""
    few, many = (world.run(count, f"memory{count}.csv", "--jobs", 2).memory for count in (n // 10, n))
    report("batch_memory_mb", few, f"for {n // 10} pictures, {many:.0f} for {n}", form=".0f")
    report("batch_memory_growth_percent", 100 * (many / few - 1), f"(bar: below {GROWTH_BAR:g})", form=".1f")


def measure_kill(world: World, n: int) -> None:
    """Kill a batch several times, and compare the table with that of an undisturbed one."""
    world.run(n, "whole.csv", "--jobs", 1)
    kills = 0
    while kills < 3:
        process = world.start(n, "killed.csv", "--jobs", 2)
        journal = world.folder / "killed.csv.parts" / "journal.sqlite-wal"
        grown = journal.stat().st_size if journal.exists() else 0
        while process.poll() is None and not (journal.exists() and journal.stat().st_size > grown + 300_000):
            time.sleep(0.02)
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.wait()
        kills += 1
    if not (world.folder / "killed.csv").exists():
        world.run(n, "killed.csv", "--jobs", 2)
    same = world.rows("killed.csv") == world.rows("whole.csv")
    report("batch_killed_same", same, f"after {kills} kills, {n} pictures")


def measure_cluster(world: World, n: int) -> None:
    """Compare two workers of a scheduler with one process."""
    address = f"tcp://127.0.0.1:{PORT}"
    commands = [["scheduler", "--host", "127.0.0.1", "--port", str(PORT), "--no-dashboard"]]
    commands += [["worker", address, "--nthreads", "1", "--no-dashboard"]] * 2
    quiet, dask = subprocess.DEVNULL, [sys.executable, "-m", "dask"]
    processes = [psutil.Popen([*dask, *command], stdout=quiet, stderr=quiet) for command in commands]
    try:
        world.run(n, "cluster.csv", "--scheduler", address)
        world.run(n, "alone.csv", "--jobs", 1)
    finally:
        for process in reversed(processes):
            for child in process.children(recursive=True):
                child.terminate()
            process.terminate()
            process.wait()
    same = world.rows("cluster.csv") == world.rows("alone.csv")
    report("batch_cluster_same", same, f"with 2 workers, {n} pictures")


MEASURES: tuple[tuple[Callable[[World, int], None], int], ...] = (
    (measure_speed, 1000),
    (measure_memory, 10_000),
    (measure_kill, 1000),
    (measure_cluster, 400),
)
"""Measurements, and their numbers of images."""


def main(share: float = 0.1) -> None:
    """Print the metrics for a fraction of the images. The bars apply to 1."""
    with tempfile.TemporaryDirectory() as folder:
        world = World(Path(folder), DISTINCT)
        world.run(2, "warm.csv", "--jobs", 1)
        for measure, n in MEASURES:
            measure(world, max(20, round(share * n)))


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))
