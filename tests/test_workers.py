"""Work in processes: bounded, and honest about workers that die."""

import os
from concurrent.futures import Future
from itertools import count, islice

import pytest

from liaam.workers import WorkerDied, flow, in_workers


def square_or_die(number):
    if number == 3:
        os._exit(3)
    return number * number


def at_once(number):
    future = Future()
    future.set_result(-number)
    return future


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
