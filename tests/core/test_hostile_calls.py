"""Calls of the compiled core whose arrays do not belong together are refused, with a reason, before a number is read.

Sizes and types are checked in the bindings and nowhere else. CI runs these tests under sanitizers too, which see what a
call that is not refused would read or write beyond its arrays.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import as_strided

from liaam import _core
from liaam.fitting import Fitter, SolverOptions
from liaam.photometry.encoding import light_table
from setups import disturb, finest_objective, make_level, problem_of

pytestmark = pytest.mark.skipif(not _core.BUILT, reason="the core is not built")

OPTIONS = SolverOptions(max_iterations=1).as_dict
TABLE = light_table(np.dtype(np.uint8).str, "value", "srgb")
BLACK = np.zeros((9, 9, 3), np.uint8)


def floats(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def unaligned(array: np.ndarray) -> np.ndarray:
    """Return the same numbers one byte off."""
    held = np.empty(array.nbytes + 1, np.uint8)
    moved = held[1:].view(array.dtype).reshape(array.shape)
    moved[...] = array
    return moved


REFUSED: dict[str, tuple[str, Callable[[], Any]]] = {
    "a base of another shape": (
        "differs in size",
        lambda: _core.clamped_newton_step(np.eye(4).reshape(2, 8), np.eye(4), np.ones(4), [True] * 4, 0.0, 0.5),
    ),
    "more pixels than there are addresses": (
        "too large",
        lambda: _core.draw_triangles(np.zeros((3, 3)), np.zeros((0, 3), np.int32), np.zeros((3, 1)), 2**33, 2**33),
    ),
    "more values than there are addresses": (
        "too large",
        lambda: _core.draw_triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 2**40)), 2**20, 2**20),
    ),
    "an image of no rows of blocks": ("at least one block", lambda: _core.area_means(floats(4, 4), 0, 2)),
    "an image of no columns of blocks": ("at least one block", lambda: _core.area_means(floats(4, 4), 2, 0)),
    "a table of another shape": (
        "entry for each stored value",
        lambda: _core.stored_means(BLACK, np.ascontiguousarray(TABLE.reshape(4, 256, 3)), 0.0, 0.0, 1.0, 1, 1),
    ),
    "an encoding that does not exist": (
        "no encoding of number 4",
        lambda: _core.encode(floats(4, 4, 4), None, False, 4, 1e-3, 0.0, (1.0, 0.0, 0.0, 1.0), 1.0),
    ),
    "a blur that is no number": ("out of range", lambda: _core.blur_planes(floats(1, 4, 4), np.nan)),
    "shares of another shape": (
        "for each pixel",
        lambda: _core.encode(floats(4, 6, 4), floats(6, 4), False, 1, 1e-3, 0.0, (1.0, 0.0, 0.0, 1.0), 1.0),
    ),
    "three free angles": (
        "at most two angles",
        lambda: _core.observable_parameters(np.eye(4), np.zeros((2, 3)), 1.0, 1.0, 25.0),
    ),
    "a loss that does not exist": ("no loss of number 9", lambda: _core.loss_weight(9, 1.0)),
    "a loss below the first": ("no loss of number -1", lambda: _core.loss_weight(-1, 1.0)),
    "a median of what has no order": ("finite", lambda: _core.median([1.0, np.nan, 0.0] * 20)),
    "values one byte off": ("not aligned", lambda: _core.area_means(unaligned(floats(4, 4)), 2, 2)),
    "an image one byte off": (
        "not aligned",
        lambda: _core.stored_luminance(unaligned(np.zeros((8, 8, 3), np.uint16)), floats(3, 1 << 16)),
    ),
    "an output one byte off": (
        "not aligned",
        lambda: _core.filter_rows_and_columns(unaligned(floats(3, 3, 1)), floats(3, 2), floats(2, 3)),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_arrays_that_do_not_belong_together_are_refused(case):
    fault, call = REFUSED[case]
    with pytest.raises(ValueError, match=fault):
        call()


def test_no_blocks_are_means_of_nothing_whatever_their_size():
    for rows, columns in ((0, 3), (3, 0), (0, 0)):
        size = 1e300 if not rows + columns else 3.0
        assert _core.stored_means(BLACK, TABLE, 0.0, 0.0, size, rows, columns).shape == (rows, columns, 4)
        assert _core.value_means(floats(9, 9, 2), 0.0, 0.0, size, rows, columns).shape == (rows, columns, 2)


def test_peaks_are_looked_for_as_far_as_the_image_reaches():
    image = np.random.default_rng(0).random((9, 7)).astype(np.float32)
    for found, expected in zip(_core.best_peaks(image, 5, 0.1, 2**62), _core.best_peaks(image, 5, 0.1, 9), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("call", ["set_state", "evaluate", "reweigh", "differentiate", "arrays"])
def test_a_problem_is_used_in_its_order(model, lit_scene, call):
    objective = finest_objective(model, "soft-li")
    image, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    problem, start = problem_of(objective, image, "core"), objective.start(p)
    calls = {
        "set_state": lambda: problem.set_state(start.p, tuple(start.angles), start.lam),
        "evaluate": lambda: problem.evaluate(True),
        "reweigh": lambda: problem.reweigh(True),
        "differentiate": lambda: problem.differentiate(True, True),
        "arrays": problem.arrays,
    }
    with pytest.raises(ValueError, match=r"call (begin|evaluate) first"):
        calls[call]()
    problem.begin(start.p, tuple(start.angles), start.lam)
    if call not in ("set_state", "evaluate"):
        with pytest.raises(ValueError, match="call evaluate first"):
            calls[call]()
        calls["evaluate"]()
    calls[call]()


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("weighting", 3, "no weighting of number 3"),
        ("loss", 7, "no loss of number 7"),
        ("step", -1, "no kind of step of number -1"),
        ("directions", np.zeros((2, 3)), "at most two angles"),
        ("weighting", 2, "two rows of gradients"),
    ],
)
def test_methods_that_do_not_exist_are_refused(model, name, value, fault):
    fields = dict(finest_objective(model, "grey").fields) | {name: value}
    with pytest.raises(ValueError, match=fault):
        _core.make_objective(fields)


@pytest.mark.parametrize("name", ["beta", "modes", "gram", "basis"])
def test_models_one_byte_off_are_refused(model, name):
    fields = dict(finest_objective(model, "grey").fields)
    fields[name] = unaligned(fields[name])
    with pytest.raises(ValueError, match="not aligned"):
        _core.make_objective(fields)


def test_points_of_another_model_are_refused(model, lit_scene):
    objective = finest_objective(model, "grey")
    image, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    n, start = len(p) + 40, objective.start(p)
    object.__setattr__(image, "point_precision", np.eye(n))
    object.__setattr__(image, "points", np.zeros(n))
    with pytest.raises(ValueError, match="precision of the points"):
        objective.problem(image)
    with pytest.raises(ValueError, match="precision of the points"):
        objective.solve(image, start, SolverOptions())


class Calls:
    """The arguments of the core's calls that a whole fit makes."""

    def __init__(self, model, scene, method: str = "soft-li") -> None:
        self.levels = Fitter(model, method).coarse_to_fine
        self.fields: dict[str, Any] = {}
        self.target: dict[str, Any] = {}
        image = np.rint(scene.image * 255).astype(np.uint8)
        target, _ = Fitter(model, method).target(image, disturb(scene.landmarks))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_core, "prepare", self._prepare)
            self.levels.fit(target, SolverOptions(max_iterations=1))

    def _prepare(self, fields: dict) -> "Calls":
        self.fields = fields
        return self

    def fit(self, image, table, grey, floor, target, options) -> list:
        self.image, self.rest, self.target = image, (grey, floor), target
        self.table, self.options = table, options
        return []

    def run(self, image: np.ndarray | None = None, table: np.ndarray | None = None, levels=None, **changes) -> list:
        """Fit with some of the fields of the model or the target changed."""
        own = {name: value for name, value in changes.items() if name in self.fields}
        theirs = {name: value for name, value in changes.items() if name in self.target}
        assert len(own) + len(theirs) == len(changes)
        prepared = _core.prepare(self.fields | own | ({} if levels is None else {"levels": levels}))
        given = self.image if image is None else image, self.table if table is None else table
        return prepared.fit(*given, *self.rest, self.target | theirs, self.options)


@pytest.fixture(scope="module")
def calls(model, lit_scene) -> Calls:
    return Calls(model, lit_scene)


def test_the_arguments_of_a_fit_are_taken_as_they_are(calls):
    assert len(calls.run()) == len(calls.fields["levels"])


DAMAGED = {
    "an encoding that does not exist": ("no encoding of number 7", {"encoding": 7}),
    "an invariant of several rows": ("one row of the metric", {"has_invariant": True}),
    "half a point": ("different numbers of points|three points", {"mean": np.arange(9.0)}),
    "a mean that is not finite": ("not finite", {"mean": np.nan}),
    "a mean without a size": ("too small", {"mean": 1.0}),
    "a start that is not finite": ("not finite, or far away", {"start": np.nan}),
    "a margin that is no number": ("margin is out of range", {"margin": np.nan}),
    "a table of noise without end": ("table of noise", {"log_noise": np.zeros((1 << 20) + 1, np.float32)}),
    "a table of noise without a width": ("table of noise", {"last_log": np.nan}),
    "points without a precision": ("mapped points", {"points": 0.0}),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_fits_whose_parts_do_not_belong_together_are_refused(calls, case):
    fault, changes = DAMAGED[case]
    whole = {
        name: np.full_like(calls.target["start"], value)
        if name in ("mean", "start", "points") and np.isscalar(value)
        else value
        for name, value in changes.items()
    }
    with pytest.raises(ValueError, match=fault):
        calls.run(**whole)


def test_levels_with_more_modes_than_the_last_are_refused(calls, model):
    """Precision of points is for the modes of the last level: a coarser one would read beyond it."""
    last = calls.fields["levels"][-1]
    fields = dict(finest_objective(model, "soft-li").fields)
    fewer = last | {
        "basis": np.ascontiguousarray(last["basis"][1:]),
        "objective": _core.make_objective(fields | {"prior": fields["prior"][1:].copy()}),
    }
    assert len(calls.run(levels=[fewer, last])) == 2
    with pytest.raises(ValueError, match="more shape modes than the last"):
        calls.run(levels=[last, fewer])


@pytest.mark.parametrize("blur", [np.nan, np.inf, -1.0, 1e9])
def test_blurs_that_are_out_of_range_are_refused(calls, blur):
    with pytest.raises(ValueError, match="blur of a level"):
        calls.run(levels=[level | {"blur": blur} for level in calls.fields["levels"]])


def test_images_whose_pixels_cannot_be_counted_are_refused(calls):
    image = as_strided(np.zeros(3, np.uint8), (50_000, 50_000, 3), (0, 0, 1))
    with pytest.raises(ValueError, match="2\\^31 pixels"):
        calls.run(image=image)
    with pytest.raises(ValueError, match="8 by 8"):
        calls.run(image=BLACK[:7])


def test_a_start_of_one_point_and_one_far_away_end(calls):
    """A scale of 0, and one of 100,000: the fit fails, and nothing is read outside of the image."""
    start = calls.target["start"]
    for changed in (np.full_like(start, 20.0), 1e5 * (start - start.mean()), start + 9e6, 1e-9 * start):
        assert calls.run(start=changed)
