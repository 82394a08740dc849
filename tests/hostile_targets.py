"""Targets with faults, for the tests of the fuzzer."""

import ctypes
import os
import time

import numpy as np

from fuzz.target import Target
from liaam.errors import LiaamError

KEPT: list[np.ndarray] = []


def make(rng):
    return bytes(rng.integers(256, size=8, dtype=np.uint8))


def sound(data):
    if data[0] % 2:
        raise LiaamError("odd")


def only(case: int, fault):
    """A target whose case of one number is faulty."""
    wanted = Target(f"{fault.__name__}", make, sound).input_of(0, case)
    return Target(fault.__name__, make, lambda data: fault() if data == wanted else sound(data))


def crash():
    ctypes.string_at(0)


def leave():
    os._exit(3)


def spin():
    while True:
        pass


def sleep():
    time.sleep(60)


def gorge():
    KEPT.append(np.ones(30_000_000))  # 240 MB


def swallow_lack():
    try:
        np.ones(10**12)
    except MemoryError as error:
        raise LiaamError("too large") from error


def foreign():
    raise ValueError("what a user would see")


def depart():
    raise SystemExit(0)


def unmade(rng):
    data = make(rng)
    if data == Target("unmade", make, sound).input_of(0, 5):
        raise ValueError("no input")
    return data


TARGETS = (
    Target("unmade", unmade, sound),
    *(only(5, fault) for fault in (crash, leave, spin, sleep, gorge, swallow_lack, foreign, depart)),
    Target("sound", make, sound),
    Target("slow_start", make, sound, lambda: time.sleep(1.0)),
)
