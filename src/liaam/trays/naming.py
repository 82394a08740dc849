"""Names of the specimens of a photograph: by position, by the code beside each, or after the only code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.io.files import some_names
from liaam.trays.codes import Code, decoder
from liaam.trays.order import diagonal, gap, hull_of

POSITION = "position"
CODE = "code"
LABEL = "label"
NAME_BY = (POSITION, CODE, LABEL)
"""What names specimens: their numbers in reading order, the code beside each, or the only code of the photograph."""

REACH = 1.0
"""Greatest gap between a specimen's landmarks and its code, of the specimen's diagonal."""

CLEARLY = 0.15
"""Least amount by which all gaps together must grow, of a diagonal, if a code belonged elsewhere."""


@dataclass(frozen=True)
class Named:
    """The name of a specimen.

    Attributes
    ----------
    name : str
    code : str
        The code beside it, or that of the photograph; empty if it is not named by one.
    fault : str
        What is not clear about it, or empty.
    """

    name: str
    code: str = ""
    fault: str = ""

    def with_fault(self, fault: str) -> Named:
        """Return it with a further fault."""
        return replace(self, fault="; ".join(filter(None, (self.fault, fault))))


def in_sentences(message: str, fault: str) -> str:
    """Return a message of whole sentences, and after it what is not clear about a specimen as a further one."""
    sentence = f"{fault[:1].upper()}{fault[1:]}." if fault else ""
    return " ".join(filter(None, (message, sentence)))


def check_name_by(by: str) -> None:
    """Raise if this is none of `NAME_BY`, or if its library is not installed."""
    if by not in NAME_BY:
        raise LiaamError(f"specimens are named by {', '.join(NAME_BY)}, not by '{by[:20]}'")
    if by != POSITION:
        decoder()


def name_specimens(
    shapes: Sequence[np.ndarray], codes: Sequence[Code], image: str, by: str = POSITION, *, single: bool = False
) -> tuple[list[Named], list[str]]:
    """Name the specimens of a photograph. Where codes do not name a specimen clearly, its position does.

    Parameters
    ----------
    shapes : sequence of (n, 2) arrays
        Landmarks of each specimen, pixels, in the order of their numbers. One without any is not named by a code.
    codes : sequence of Code
        What :func:`read_codes` read.
    image : str
        Name of the photograph without its ending.
    by : str
        ``"position"``: ``image#1``, ``image#2``, ... ``"code"``: each by the code beside it. ``"label"``: ``code#1``,
        ``code#2``, ... after the only code of the photograph.
    single : bool
        Whether there is one specimen, whose name has no number.

    Returns
    -------
    named : list of Named
        For each specimen.
    faults : list of str
        What is not clear, and what it is about.
    """
    numbers = [""] if single else [f"#{number}" for number in range(1, len(shapes) + 1)]
    positions = [Named(f"{image}{number}") for number in numbers]
    if by == POSITION:
        return positions, []
    if not codes:
        fault = "no code is read, so that positions name the specimens"
        return [Named(each.name, fault=fault) for each in positions], [fault]
    if by == LABEL:
        return _after_label(positions, numbers, codes)
    return _by_codes(positions, shapes, codes)


def _after_label(
    positions: Sequence[Named], numbers: Sequence[str], codes: Sequence[Code]
) -> tuple[list[Named], list[str]]:
    """Name specimens after the only code."""
    texts = sorted({code.text for code in codes})
    if len(texts) > 1:
        fault = f"{len(texts)} codes ({some_names(texts)}) where one names the photograph, so that positions name them"
        return [Named(each.name, fault=fault) for each in positions], [fault]
    return [Named(f"{texts[0]}{number}", texts[0]) for number in numbers], []


def _by_codes(
    positions: Sequence[Named], shapes: Sequence[np.ndarray], codes: Sequence[Code]
) -> tuple[list[Named], list[str]]:
    """Name each specimen by the code beside it."""
    counts = Counter(code.text for code in codes)
    doubled = sorted(text for text, count in counts.items() if count > 1)
    faults = [f"the code '{text}' is at {counts[text]} places, so that it names no specimen" for text in doubled]
    pairs, unclear = _pairs(_gaps(shapes, codes))
    named = list(positions)
    lacking = []
    for i, each in enumerate(positions):
        code = pairs.get(i)
        text = "" if code is None else codes[code].text
        if text and text not in doubled and i not in unclear:
            named[i] = Named(text, text)
            continue
        why = "no code is beside it"
        if text:
            why = (
                f"the code '{text}' is at several places" if text in doubled else f"the code '{text}' may be another's"
            )
        named[i] = Named(each.name, fault=f"{why}, so that its position names it")
        lacking.append(f"{each.name} ({why})")
    used = set(pairs.values())
    spare = sorted({code.text for j, code in enumerate(codes) if j not in used} - set(doubled))
    if lacking:
        faults.append(f"positions name {some_names(lacking)}")
    if spare:
        faults.append(f"no specimen is beside the code {some_names([repr(text) for text in spare])}")
    return named, faults


def _gaps(shapes: Sequence[np.ndarray], codes: Sequence[Code]) -> np.ndarray:
    """Return the gap between each specimen and each code (n, m), of the specimen's diagonal."""
    gaps = np.full((len(shapes), len(codes)), np.inf)
    for i, hull in enumerate(map(hull_of, shapes)):
        size = diagonal(hull) if len(hull) else 0.0
        if size > 0:
            gaps[i] = [gap(hull, hull_of(code.corners)) / size for code in codes]
    return gaps


def _pairs(gaps: np.ndarray) -> tuple[dict[int, int], set[int]]:
    """Return the code of each specimen that has one, and the specimens whose code may belong to another.

    The sum of the gaps is the least, where a specimen or a code without partner counts as half of `REACH`. A pair is
    clear if the sum would grow by `CLEARLY` without it.
    """
    best, pairs = _least(gaps)
    unclear = set()
    for i, j in pairs.items():
        others = gaps.copy()
        others[i, j] = np.inf
        second, _ = _least(others)
        if second - best < CLEARLY:
            unclear.add(i)
    return pairs, unclear


def _least(gaps: np.ndarray) -> tuple[float, dict[int, int]]:
    """Return the least sum of gaps (n, m), and the pairs that have it."""
    from scipy.optimize import linear_sum_assignment

    n, m = gaps.shape
    costs = np.full((n + m, m + n), REACH / 2)  # without a partner
    costs[:n, :m] = np.where(gaps < REACH, gaps, 2 * REACH)
    costs[n:, m:] = 0.0
    rows, columns = linear_sum_assignment(costs)
    pairs = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if i < n and j < m and gaps[i, j] < REACH}
    return float(costs[rows, columns].sum()), pairs
