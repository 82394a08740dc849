"""Progress of training, in units of about the same time."""

from dataclasses import dataclass

from liaam.progress import Progress

FITTED = 6
"""Time of fitting a left-out image, from near and far starts, in units of the time of sampling an image."""


def learning_cost(n: int) -> int:
    """Time of learning a level's appearances from n images, in units of the time of sampling one of them."""
    return max(1, n // 10)


@dataclass
class Steps:
    """Reports all steps of training on one scale."""

    report: Progress | None
    total: int
    done: int = 0

    def next(self, what: str, cost: int = 1) -> None:
        """Report the next step and its cost, in units of the time of sampling an image."""
        if self.report:
            self.report(self.done, self.total, what)
        self.done += cost
