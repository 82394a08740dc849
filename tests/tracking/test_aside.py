"""Work aside: in order, all of it, and not in silence when it fails."""

import signal
import threading
import time

import pytest

from liaam.tracking.aside import WAITING, aside


def test_everything_is_done_in_order_on_another_thread():
    done, threads = [], set()

    def work(number, letter):
        time.sleep(0.001)
        done.append((number, letter))
        threads.add(threading.get_ident())

    with aside(work) as take:
        for i in range(5 * WAITING):
            take(i, "a")
    assert done == [(i, "a") for i in range(5 * WAITING)]
    assert len(threads) == 1 and threading.get_ident() not in threads


def test_whoever_brings_too_much_waits():
    goes_on, started = threading.Event(), []

    def work(number):
        started.append(number)
        goes_on.wait(60)

    brought = []
    with aside(work) as take:

        def bring():
            for i in range(WAITING + 5):
                take(i)
                brought.append(i)

        other = threading.Thread(target=bring)
        other.start()
        other.join(0.5)
        assert other.is_alive() and len(brought) <= WAITING + 1
        goes_on.set()
        other.join(60)
    assert started == list(range(WAITING + 5))


def test_a_failure_is_told_to_who_brings_more():
    def work(number):
        if number == 1:
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk is full"), aside(work) as take:
        for i in range(10_000):
            take(i)
            time.sleep(0.001)
    assert i < 5_000


def test_a_failure_of_the_last_item_is_told_at_the_end():
    def work(_number):
        time.sleep(0.05)
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk is full"), aside(work) as take:
        take(0)


def test_an_error_outside_leaves_the_rest_undone_and_no_thread_behind():
    done = []

    def work(number):
        time.sleep(0.05)
        done.append(number)

    with pytest.raises(KeyboardInterrupt), aside(work) as take:
        for i in range(WAITING):
            take(i)
        raise KeyboardInterrupt
    assert len(done) < WAITING
    left = [thread for thread in threading.enumerate() if thread.name.startswith("aside")]
    for thread in left:
        thread.join(60)
    assert not any(thread.is_alive() for thread in left)


@pytest.fixture
def interruptible():
    """Mind Ctrl-C, also where the tests run in a shell's background and ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_an_interrupt_at_the_end_waits_for_the_work_at_hand(interruptible):
    """What the work writes to is closed after the block: nothing may be under way then."""
    under_way, sent, ended = threading.Event(), threading.Event(), []

    def work(number):
        under_way.set()
        sent.wait(60)
        time.sleep(0.3)
        ended.append(number)

    def interrupt():
        under_way.wait(60)
        time.sleep(0.1)  # a signal that comes just before somebody waits is heard after
        signal.pthread_kill(main, signal.SIGINT)
        sent.set()

    main = threading.main_thread().ident or 0
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt), aside(work) as take:
        for i in range(3):
            take(i)
    after = len(ended)
    assert 1 <= after < 3
    time.sleep(0.7)
    assert len(ended) == after
