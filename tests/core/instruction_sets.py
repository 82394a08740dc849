"""Whole fits with each instruction set, and how far apart they end: none of them is the right one but the NumPy one.

    python tests/core/instruction_sets.py

A model of the heads that come with liaam is trained once. Then a process for each ``LIAAM_CPU`` fits it to pictures
that it has not seen, with methods of all kinds of steps, weights and encodings. The baseline build is all that some
machines have, such as those with ARM, and nothing else in CI computes with it.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

METHODS = ("soft-li", "grey", "rgb", "li", "igo", "grey+tukey", "li+noise")
DIFFERENT = ("baseline", "avx2")  # instruction sets, each compared with NUMPY
NUMPY = "numpy"
PICTURES = ("head-1-3", "head-3-3", "head-5-3")

# Standard deviations by which a landmark may differ. Sums in another order change a residual by 1e-6 of it, which by
# itself moves no landmark by 1e-3 of its deviation: 0.0001 is the largest that was seen. A fit may also end at another
# kink of the bilinear interpolant, 0.002 further (tests/fitting/test_repeatable.py); ten times that is a fault.
MOST_APART = 0.02


def fit_all(model_path: Path, out: Path) -> None:
    """Fit all pictures with the instruction set of this process, and write landmarks and standard deviations."""
    from liaam import _core
    from liaam.datasets import load_heads
    from liaam.fitting import Fitter
    from liaam.model import load_model

    asked = os.environ["LIAAM_CPU"]
    assert asked == _core.INSTRUCTION_SET, f"{asked} was asked for, but {_core.INSTRUCTION_SET} is used"
    model = load_model(model_path)
    heads = [head for head in load_heads()[0] if head.name in PICTURES]
    assert len(heads) == len(PICTURES)
    found = {}
    for method in METHODS:
        fitter = Fitter(model, method)
        for head in heads:
            result = fitter.fit(head.read_image(), head.landmarks.points)
            deviations = np.sqrt(np.einsum("nii->n", result.landmark_covariances) / 2)
            found[f"{method} {head.name}"] = np.column_stack([result.landmarks, deviations])
    np.savez(out, **found)


def run(asked: str, model: Path, out: Path) -> dict[str, np.ndarray] | None:
    """Fit with an instruction set in a process of its own; None if this installation or processor does not have it."""
    from liaam import _core

    if asked not in (NUMPY, "baseline", _core.INSTRUCTION_SET):
        return None
    environment = {**os.environ, "LIAAM_CPU": asked}
    environment.pop("LIAAM_REQUIRE_CORE", None)  # NumPy is asked for
    subprocess.run([sys.executable, __file__, "--fit", str(model), str(out)], env=environment, check=True)
    return dict(np.load(out))


def apart(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest distance between landmarks of each method's fits, in their standard deviations."""
    largest = dict.fromkeys(METHODS, 0.0)
    for name, found in one.items():
        expected, method = other[name], name.split()[0]
        distances = np.linalg.norm(found[:, :2] - expected[:, :2], axis=1) / expected[:, 2]
        largest[method] = max(largest[method], float(distances.max()))
    return largest


def main() -> None:
    """Train, fit with each instruction set, print how far apart the fits are, and fail if that is too far."""
    from liaam.datasets import load_heads
    from liaam.training import train

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "heads.liaam"
        shown = [head for head in load_heads()[0] if head.name not in PICTURES]
        train(shown, diagonal=50.0, leave_out=False, lamps=None, methods="all", progress=False).save(path)
        expected = run(NUMPY, path, Path(folder) / "numpy.npz")
        assert expected is not None
        for asked in DIFFERENT:
            found = run(asked, path, Path(folder) / f"{asked}.npz")
            if found is None:
                print(f"{asked}: not on this machine")
                continue
            off = apart(found, expected)
            each = ", ".join(f"{method} {value:.4f}" for method, value in off.items())
            print(f"{asked} and {NUMPY}, largest difference in standard deviations: {each}")
            assert max(off.values()) < MOST_APART, f"{asked} is more than {MOST_APART} standard deviations off"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fit", nargs=2, type=Path)
    arguments = parser.parse_args()
    if arguments.fit:
        fit_all(*arguments.fit)
    else:
        main()
