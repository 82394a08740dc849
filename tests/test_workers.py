"""Work in threads and processes: bounded, and safe to start."""

import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from itertools import count, islice

import pytest

from liaam.workers import flow, in_order


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


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_an_interrupt_waits_for_the_work_at_hand_and_leaves_the_rest():
    """What the work writes to is closed after it: nothing may be under way then."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    under_way, sent, ended, main = threading.Event(), threading.Event(), [], threading.main_thread().ident or 0

    def work(number):
        under_way.set()
        sent.wait(60)
        time.sleep(0.3)
        ended.append((number, threading.get_ident()))

    def interrupt():
        under_way.wait(60)
        time.sleep(0.1)  # a signal that comes just before somebody waits is heard after
        signal.pthread_kill(main, signal.SIGINT)
        sent.set()

    threading.Thread(target=interrupt).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            list(in_order(work, range(3), 1))
    finally:
        signal.signal(signal.SIGINT, before)
    assert [number for number, _ in ended] == [0] and ended[0][1] != main
    time.sleep(0.7)
    assert len(ended) == 1
