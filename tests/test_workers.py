"""Work in threads and processes: bounded, and safe to start."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import count, islice

import pytest

from liaam.workers import flow, in_order


def at_once(number):
    future = Future()
    future.set_result(-number)
    return future


LOADED_AFTER_A_HOLD = """
import sys

from threadpoolctl import threadpool_info
from liaam.workers import one_numpy_thread

with one_numpy_thread():
    assert "scipy" not in sys.modules
import scipy.linalg  # brings a BLAS of its own

with one_numpy_thread():
    print({info["num_threads"] for info in threadpool_info()})
"""

WHILE_OPENCV_IS_IMPORTED = """
import sys, threading, time
from liaam.workers import fresh_interpreters

def trace(frame, event, argument):
    if not frame.f_code.co_filename.endswith("cv2/__init__.py"):
        return None
    if sys.argv[1] in frame.f_locals and not reached.is_set():
        reached.set()
        seen.wait(60)
        time.sleep(0.5)  # while the other thread starts the process, were it not to wait
    return trace

def import_opencv():
    sys.settrace(trace)
    import cv2

if __name__ == "__main__":
    reached, seen = threading.Event(), threading.Event()
    threading.Thread(target=import_opencv).start()
    assert reached.wait(60)
    assert any(entry.endswith("cv2") for entry in sys.path)
    seen.set()
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


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_an_interrupt_waits_for_the_work_at_hand_and_leaves_the_rest(monkeypatch):
    """What the work writes to is closed after it: nothing may be under way then."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    under_way, dropped, ended, main = threading.Event(), threading.Event(), [], threading.main_thread().ident or 0
    close = ThreadPoolExecutor.shutdown

    def work(number):
        under_way.set()
        dropped.wait(60)
        time.sleep(0.1)  # long enough for somebody who does not wait for it
        ended.append((number, threading.current_thread()))

    def interrupt():
        under_way.wait(60)
        signal.pthread_kill(main, signal.SIGINT)

    def shutdown(pool, wait=True, *, cancel_futures=False):
        """First what is not begun is dropped, if it is, and only then the work at hand goes on."""
        close(pool, False, cancel_futures=cancel_futures)
        dropped.set()
        close(pool, wait)

    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", shutdown)
    threading.Thread(target=interrupt).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            list(in_order(work, range(3), 1))
    finally:
        signal.signal(signal.SIGINT, before)
    ((number, thread),) = ended
    assert number == 0
    assert thread.ident != main and not thread.is_alive()  # so that nothing more can come


def test_a_library_that_is_loaded_after_a_hold_is_limited_in_the_next_one():
    several = {**os.environ, "OPENBLAS_NUM_THREADS": "3", "OMP_NUM_THREADS": "3", "MKL_NUM_THREADS": "3"}
    command = [sys.executable, "-c", LOADED_AFTER_A_HOLD]
    done = subprocess.run(command, capture_output=True, text=True, env=several)
    assert done.stdout.strip() == "{1}", done.stderr
