"""Corruption of valid bytes, text and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np

Random = np.random.Generator

LONGEST = 200_000
"""Maximum size of an input in bytes, enough to detect code with quadratic time."""

BYTES = (
    b"\0",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"\x01",
    b"\xff\xff\xff\xff",
    b"\0\0\0\0",
    b"\x7f\xff\xff\xff",
    b"\x80\0\0\0",
)

NUMBERS = (
    *(b"-1", b"0", b"1", b"2", b"65536", b"2147483648", b"4294967295", b"9223372036854775808", b"1e308", b"-1e308"),
    *(b"1e999", b"-1e999", b"nan", b"NaN", b"Infinity", b"-Infinity", b"5e-324", b"1_0", b"0x10", b"1e", b"\xd9\xa3"),
    *(b"9" * 30, b"9" * 5000, b"0." + b"0" * 400 + b"1", b"", b"-0", b"1.5", b"1000000000"),
)
"""Replacements for a number."""

TEXTS = (
    "",
    " ",
    "\0",
    "\x1b[31m",
    "\ud800",
    "é",
    "𝔘",
    "../x",
    "/",
    "a" * 300,
    "a" * 10_000,
    "%s",
    "{0}",
    "nan",
    "\r\n",
)

VALUES = (
    *(None, True, False, -1, 0, 1, 0.5, 2**31, 2**63, 10**30, 10**400, 1e308, -1e308, 5e-324),
    *(
        float("inf"),
        float("-inf"),
        float("nan"),
        [],
        {},
        [[]],
        [None],
        [{}],
        {"": None},
        "x",
        "1",
        [1],
        [1, 2],
        [0] * 1000,
    ),
    *TEXTS,
)
"""Replacements for any JSON value."""

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def one_of(rng: Random, values: Sequence[Any]) -> Any:
    """Draw one of several values of any type."""
    return values[int(rng.integers(len(values)))]


def spoilt(rng: Random, corpus: Sequence[bytes], words: Sequence[bytes] = ()) -> bytes:
    """Return one of some valid files with a few faults, or sometimes without any.

    Parameters
    ----------
    rng : numpy.random.Generator
    corpus : sequence of bytes
    words : sequence of bytes
        Tokens of the format, to insert anywhere.
    """
    data = one_of(rng, corpus)
    for _ in range(int(rng.geometric(0.45)) - (rng.random() < 0.05)):
        data = one_of(rng, _FAULTS)(rng, data, corpus, words)[:LONGEST]
    return data


def _span(rng: Random, data: bytes) -> tuple[int, int]:
    """Draw the beginning and end of a part, usually a short one."""
    begin = int(rng.integers(len(data) + 1))
    return begin, begin + min(int(rng.geometric(0.5 ** rng.integers(1, 10))), len(data) - begin)


def _change_bits(rng: Random, data: bytes, _corpus: object, _words: object) -> bytes:
    changed = bytearray(data)
    for at in rng.integers(len(data), size=int(rng.geometric(0.3))) if data else ():
        changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _put_bytes(rng: Random, data: bytes, _corpus: object, words: Sequence[bytes]) -> bytes:
    begin, end = _span(rng, data)
    put = one_of(rng, words) if words and rng.random() < 0.6 else one_of(rng, BYTES)
    keep_length = rng.random() < 0.5
    return data[:begin] + put + data[begin + len(put) if keep_length else one_of(rng, (begin, end)) :]


def _cut_short(rng: Random, data: bytes, _corpus: object, _words: object) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _take_out(rng: Random, data: bytes, _corpus: object, _words: object) -> bytes:
    begin, end = _span(rng, data)
    return data[:begin] + data[end:]


def _repeat(rng: Random, data: bytes, _corpus: object, words: Sequence[bytes]) -> bytes:
    """Repeat a part or a word a few times, or sometimes often enough to reveal slow parsing."""
    begin, end = _span(rng, data)
    part = one_of(rng, words) if words and rng.random() < 0.3 else data[begin:end]
    most = LONGEST // 2 // max(len(part), 1) if rng.random() < 0.02 else 10
    return data[:end] + part * int(rng.integers(1, max(most, 1) + 1)) + data[end:]


def _join(rng: Random, data: bytes, corpus: Sequence[bytes], _words: object) -> bytes:
    other = one_of(rng, corpus)
    return data[: int(rng.integers(len(data) + 1))] + other[int(rng.integers(len(other) + 1)) :]


def _put_number(rng: Random, data: bytes, _corpus: object, _words: object) -> bytes:
    found = list(_NUMBER.finditer(data[:2000] if len(data) > 20_000 else data))
    if not found:
        return data
    at = one_of(rng, found)
    return data[: at.start()] + one_of(rng, NUMBERS) + data[at.end() :]


_FAULTS = (_change_bits, _put_bytes, _cut_short, _take_out, _repeat, _join, _put_number, _put_number)


def spoilt_json(rng: Random, documents: Sequence[Any]) -> bytes:
    """Return one of some JSON documents with values replaced, taken away, doubled or nested, as bytes."""
    document = json.loads(json.dumps(one_of(rng, documents)))
    for _ in range(int(rng.geometric(0.5))):
        document = _spoil(rng, document)
    return json.dumps(document, ensure_ascii=bool(rng.random() < 0.8)).encode("utf-8", "surrogatepass")


def _spoil(rng: Random, value: Any) -> Any:
    """Corrupt a value of a document, or a value inside it."""
    if not isinstance(value, list | dict) or not value or rng.random() < 0.1:
        # A copy, because later corruption may change this value, and the next case needs the original.
        return _nested(rng, value) if rng.random() < 0.05 else deepcopy(one_of(rng, VALUES))
    key = one_of(rng, list(value) if isinstance(value, dict) else range(len(value)))
    if rng.random() < 0.1:
        del value[key]
    elif rng.random() < 0.05 and isinstance(value, list):
        most = 2 if isinstance(value[key], list | dict) else 1000  # nested values would grow exponentially
        value[key:key] = value[key : key + 1] * int(rng.integers(1, most))
    elif rng.random() < 0.05 and isinstance(value, dict):
        value[one_of(rng, TEXTS)] = value.pop(key)
    else:
        value[key] = _spoil(rng, value[key])
    return value


def _nested(rng: Random, value: Any) -> Any:
    for _ in range(int(rng.integers(1, 300))):
        value = [value]
    return value
