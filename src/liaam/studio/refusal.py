"""Refused requests. Commands read the studio's files through this as well, so that it needs no web server."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from liaam.errors import LiaamError


class Refusal(LiaamError):  # noqa: N818 (an answer, not a program error)
    """A refused request: an HTTP status, an error message, and ``details``, further fields of the answer."""

    def __init__(self, status: int, error: str, **details: Any) -> None:
        super().__init__(error)
        self.status = status
        self.details = details


@contextmanager
def refusing() -> Iterator[None]:
    """Refuse the request if what it sent raises an error in the block."""
    try:
        yield
    except LiaamError as fault:
        raise fault if isinstance(fault, Refusal) else Refusal(422, str(fault)) from fault
