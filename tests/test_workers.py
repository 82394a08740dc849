"""Work in processes: bounded, and honest about workers that die."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from functools import partial
from itertools import count, islice
from pathlib import Path

import pytest

from liaam.errors import LiaamError
from liaam.workers import WorkerDied, deaf_to_interrupts, flow, in_workers


def square_or_die(number):
    if number == 3:
        os._exit(3)
    return number * number


def at_once(number):
    future = Future()
    future.set_result(-number)
    return future


WHILE_OPENCV_IS_IMPORTED = """
import sys, threading, time
from liaam.workers import fresh_interpreters

def trace(frame, event, argument):
    if not frame.f_code.co_filename.endswith("cv2/__init__.py"):
        return None
    if sys.argv[1] in frame.f_locals and not reached.is_set():
        reached.set()
        time.sleep(0.5)
    return trace

def import_opencv():
    sys.settrace(trace)
    import cv2

if __name__ == "__main__":
    reached = threading.Event()
    threading.Thread(target=import_opencv).start()
    assert reached.wait(20)
    assert any(entry.endswith("cv2") for entry in sys.path)
    process = fresh_interpreters().Process(target=print, args=("alive",))
    process.start()
    process.join()
    sys.exit(process.exitcode)
"""


@pytest.mark.parametrize("known", ["py_module", "native_module"])  # before and after OpenCV's extension is loaded
def test_a_process_can_start_while_a_thread_imports_opencv(tmp_path, known):
    script = tmp_path / "script.py"
    script.write_text(WHILE_OPENCV_IS_IMPORTED)
    ran = subprocess.run([sys.executable, script, known], capture_output=True, text=True)
    assert ran.returncode == 0 and ran.stdout == "alive\n", ran.stderr


def test_no_more_is_taken_than_there_is_room_for():
    taken = []
    numbers = (taken.append(i) or i for i in count())
    for number, future in islice(flow(at_once, numbers, lambda: 4), 10):
        assert future.result() == -number
        assert len(taken) <= number + 5 + 4


def test_workers_give_all_results(rng):
    numbers = [int(n) for n in rng.integers(4, 99, 7)]
    assert sorted(in_workers(square_or_die, numbers, 1)) == sorted((n, n * n) for n in numbers)


def test_a_worker_that_dies_gives_back_what_was_under_way():
    rest, results = iter(range(10)), []
    with pytest.raises(WorkerDied) as death:
        results.extend(in_workers(square_or_die, rest, 1))
    assert 3 in death.value.items
    left = [*death.value.items, *rest]
    assert sorted(left)[-1] == 9
    assert len(left) >= 7


def die_in_the_middle_of_a_result(number):
    if number:
        return number
    main = threading.main_thread().ident

    def watch():
        while not any(frame.f_code.co_name == "_send" for frame in frames_of(main)):
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()
    return bytes(200_000_000)


def frames_of(thread):
    frame = sys._current_frames().get(thread)
    while frame is not None:
        yield frame
        frame = frame.f_back


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_worker_that_dies_in_the_middle_of_a_result_is_noticed():
    done = []
    with pytest.raises(WorkerDied) as death:
        done.extend(in_workers(die_in_the_middle_of_a_result, range(4), 2))
    assert death.value.items == [0]
    assert {item for item, _ in done} <= {1, 2, 3}


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds its children in /proc")
def test_a_worker_that_dies_before_it_has_read_its_job_is_noticed():
    """Parents that give a large job while the process starts wait for ever."""
    mine = set(children())

    def kill():
        while not (workers := [pid for pid in set(children()) - mine if b"spawn_main" in command_of(pid)]):
            time.sleep(0.001)
        os.kill(workers[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(WorkerDied):
        list(in_workers(partial(isinstance, bytes(10_000_000)), [1], 1))
    killer.join()


def children():
    return [int(pid) for tasks in Path("/proc/self/task").glob("*/children") for pid in tasks.read_text().split()]


def command_of(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def refuse(number):
    raise LiaamError(f"{number} is refused")


def test_what_a_worker_raises_is_raised_with_where_it_was():
    with pytest.raises(LiaamError, match="is refused") as caught:
        list(in_workers(refuse, [1, 2], 2))
    assert "in refuse" in caught.value.__notes__[0]


def lock(number):
    return threading.Lock() if number == 2 else number


def test_a_result_that_cannot_be_pickled_is_reported_as_such():
    with pytest.raises(TypeError, match=r"cannot pickle '_thread\.lock'") as caught:
        list(in_workers(lock, [1, 2, 3], 1))
    assert "In a worker process" in caught.value.__notes__[0]


class OneWay(Exception):  # noqa: N818
    """An error that can be pickled but not unpickled."""

    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def raise_one_way(_number):
    raise OneWay("this", "that")


def test_an_error_that_cannot_be_unpickled_is_reported_with_its_name():
    with pytest.raises(RuntimeError, match="OneWay: this and that") as caught:
        list(in_workers(raise_one_way, [1], 1))
    assert "in raise_one_way" in caught.value.__notes__[0]


def die_or_wait(number):
    if number == 0:
        os._exit(3)
    time.sleep(60)


def test_a_death_is_noticed_at_once_if_the_others_need_not_finish():
    began = time.perf_counter()
    with pytest.raises(WorkerDied) as death:
        list(in_workers(die_or_wait, [0, 1], 2, stop_at_death=True))
    assert death.value.items == [0]
    assert time.perf_counter() - began < 30


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals of POSIX")
def test_a_ctrl_c_while_processes_start_is_not_lost():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    with pytest.raises(KeyboardInterrupt):
        with deaf_to_interrupts():
            signal.raise_signal(signal.SIGINT)
            reached = True
        time.sleep(1)
    signal.signal(signal.SIGINT, before)
    assert reached
