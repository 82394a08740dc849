"""Specimens of a photograph: what is said where none is left, where some may be none, and where some touch."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from liaam.fitting import FitStatus, specimens
from liaam.fitting.specimens import fit_specimens
from liaam.trays import Code
from tests.trays.test_order import SQUARE

PAPER = np.full((300, 300, 3), 200, np.uint8)


@dataclass
class Finder:
    """A fitter whose objects were fitted before."""

    fits: list[SimpleNamespace] = field(default_factory=list)
    codes: list[np.ndarray] = field(default_factory=list)

    def fit_objects(self, _image, _name, codes) -> list[SimpleNamespace]:
        self.codes = codes
        return self.fits


def fitter(*fits: SimpleNamespace) -> Any:
    return Finder(list(fits))


def fit_at(left: float, status: FitStatus = FitStatus.CONVERGED) -> SimpleNamespace:
    place = SQUARE + np.array([left, 0.0])
    return SimpleNamespace(landmarks=place, place=place, status=status, message=status.message)


def test_what_lies_on_a_code_is_no_object(monkeypatch):
    monkeypatch.setattr(specimens, "read_codes", lambda _: [Code("A1", SQUARE + 200.0)])
    monkeypatch.setattr(specimens, "check_name_by", lambda _: None)
    of_codes = fitter(fit_at(0))
    fit_specimens(of_codes, PAPER, name="tray.png", name_by="code")
    np.testing.assert_array_equal(of_codes.codes, [SQUARE + 200.0])


@pytest.mark.parametrize("status", [FitStatus.DOUBTFUL, FitStatus.DIVERGED])
def test_numbers_after_a_fit_that_may_not_be_used_may_be_too_high(status):
    fitted = fit_specimens(fitter(fit_at(0, status), fit_at(100)), PAPER, stem="tray")
    assert fitted.faults == [
        "fits that may not be used: tray#1; if these are no specimens, the numbers after them are too high"
    ]
    assert fit_specimens(fitter(fit_at(0), fit_at(100, status)), PAPER).faults == []  # it is the last


def test_a_doubtful_fit_beside_the_rows_comes_last_and_one_among_them_does_not():
    size = float(np.ptp(SQUARE[:, 0]))

    def at(column, row, status=FitStatus.CONVERGED):
        fit = fit_at(0, status)
        fit.landmarks = fit.place = SQUARE + 2.5 * size * np.array([column, row])
        return fit

    fits = [at(0.5, -0.6, FitStatus.DOUBTFUL), at(0, 0), at(1, 0, FitStatus.DIVERGED), at(2, 0), at(0, 1), at(1, 1)]
    fitted = fit_specimens(fitter(*fits), PAPER, stem="tray")
    assert [[result is fit for fit in fits].index(True) for result in fitted.results] == [1, 2, 3, 4, 5, 0]
    assert fitted.faults == [
        "fits that may not be used: tray#2; if these are no specimens, the numbers after them are too high",
        "fits that may not be used, in no row and column of the others, come last: tray#6; if one is a specimen, the "
        "numbers after its place are too low",
    ]


def test_messages_are_whole_sentences():
    width = float(np.ptp(SQUARE[:, 0]))
    fitted = fit_specimens(fitter(fit_at(0), fit_at(width)), PAPER, stem="tray")
    assert fitted.message(0) == "The fit converged. It touches tray#2, or nearly: check its landmarks."
    assert fit_specimens(fitter(fit_at(0)), PAPER).message(0) == "The fit converged."
