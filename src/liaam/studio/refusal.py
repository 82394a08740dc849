"""Refused requests. Commands read the studio's files through this as well, so that it needs no web server."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Unpack

from liaam.errors import LiaamError

if TYPE_CHECKING:
    from liaam.studio.contract import Details


class Refusal(LiaamError):  # noqa: N818 (an answer, not a program error)
    """A refused request: an HTTP status, an error message, and ``details``, further fields of the answer.

    The client of a busy server is asked to try again after so many seconds, ``retry_after``.
    """

    def __init__(
        self, status: int, error: str, *, retry_after: int | None = None, **details: "Unpack[Details]"
    ) -> None:
        super().__init__(error)
        self.status = status
        self.retry_after = retry_after
        self.details = details


@contextmanager
def refusing() -> Iterator[None]:
    """Refuse the request if what it sent raises an error in the block."""
    try:
        yield
    except LiaamError as fault:
        raise fault if isinstance(fault, Refusal) else Refusal(422, str(fault)) from fault
