"""Whole fits of the core: those of the reference, the same in any thread, and interruptible."""

import _thread
import importlib
import os
import pickle
import platform
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from liaam import _core
from liaam.fitting import METHODS, Fitter, SolverOptions, get_method
from liaam.fitting.loop.levels import CoarseToFine, FittedLevel, solve_levels
from liaam.photometry.encoding import value_luminance
from setups import disturb, finest_objective, make_level, model_pixels, stands_light, without_core

pytestmark = pytest.mark.skipif(not _core.BUILT, reason="the core is not built")

WEIGHED = ("soft-li+tukey", "grey+tukey", "rgb+learnt", "li+noise", "li-pcs+cauchy", "igo+geman-mcclure")
IN_CORE = [name for name in (*METHODS, *WEIGHED) if not get_method(name).normalise]
SHORT = SolverOptions(max_iterations=4)
"""Longer fits may differ in the number of steps, by rounding."""


@pytest.mark.parametrize(
    ("method", "light"),
    [(name, "same") for name in IN_CORE] + [(name, "other") for name in IN_CORE if stands_light(name)],
)
def test_whole_fits_are_those_of_the_reference(model, same_light_scene, lit_scene, method, light):
    scene = same_light_scene if light == "same" else lit_scene
    start = disturb(scene.landmarks)
    core = Fitter(model, method, SHORT).fit(scene.image, start)
    with without_core():
        reference = Fitter(model, method, SHORT).fit(scene.image, start)
    assert core.n_iterations == reference.n_iterations
    assert model_pixels(model, core.landmarks, reference.landmarks) < 1e-2
    np.testing.assert_allclose(core.cost, reference.cost, rtol=2e-3)
    np.testing.assert_allclose(core.lam, reference.lam, atol=5e-3 * np.abs(reference.lam).max())
    np.testing.assert_allclose(core.landmark_covariances, reference.landmark_covariances, rtol=0.05, atol=1e-6)
    np.testing.assert_allclose(core.evidence, reference.evidence, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("method", ["soft-li", "li", "grey", "igo"])
def test_one_call_is_the_levels_one_by_one(model, lit_scene, method, dtype):
    """The blocks, the encoding and the noise of each level are those of the Python modules that training uses."""
    image = lit_scene.image if dtype == np.float32 else np.rint(lit_scene.image * np.iinfo(dtype).max).astype(dtype)
    fitter = Fitter(model, method, SHORT)
    for scale in (1.0, 0.4, 2.3):
        size = np.array(image.shape[1::-1]) * scale
        y, x = (np.linspace(0, n - 1, int(m)).astype(int) for n, m in zip(image.shape, size[::-1], strict=False))
        target, _ = fitter.target(image[np.ix_(y, x)], scale * disturb(lit_scene.landmarks))
        one, other = fitter.coarse_to_fine.fit(target, SHORT), solve_levels(fitter.objectives, target, SHORT)
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a.reached, b.reached, atol=2e-2)
            np.testing.assert_array_equal(a.patch_size, b.patch_size)
            np.testing.assert_allclose(a.to_patch.offset, b.to_patch.offset, atol=1e-9)
            np.testing.assert_allclose(a.solution.costs, b.solution.costs, rtol=2e-3)


def test_threads_that_share_a_fitter_get_the_bits_of_one(model, same_light_scene, lit_scene):
    fitters = {method: Fitter(model, method) for method in ("soft-li", "li", "grey", "igo")}
    scenes = (same_light_scene, lit_scene)
    tasks = [(method, scene) for method in fitters for scene in scenes] * 5

    def fit(task):
        method, scene = task
        return fitters[method].fit(scene.image, disturb(scene.landmarks))

    alone = [fit(task) for task in tasks]
    with ThreadPoolExecutor(10) as pool:
        together = list(pool.map(fit, tasks))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.landmarks, other.landmarks)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_pickled_fitter_gives_the_same_bits(model, lit_scene):
    for method in ("soft-li", "li"):
        fitter, start = Fitter(model, method), disturb(lit_scene.landmarks)
        first = fitter.fit(lit_scene.image, start)
        again = pickle.loads(pickle.dumps(fitter)).fit(lit_scene.image, start)
        np.testing.assert_array_equal(again.landmarks, first.landmarks)
        np.testing.assert_array_equal(again.covariance, first.covariance)


@pytest.mark.parametrize("kind", ["strided", "read only", "of four channels", "mirrored", "float16"])
def test_images_of_any_layout_are_fitted(model, lit_scene, kind):
    image, start = np.rint(lit_scene.image * 255).astype(np.uint8), disturb(lit_scene.landmarks)
    expected = Fitter(model).fit(image, start)
    given = {
        "strided": np.repeat(image, 2, axis=1)[:, ::2],
        "of four channels": np.concatenate([image, image[..., :1]], axis=2),
        "mirrored": np.ascontiguousarray(image[..., ::-1])[..., ::-1],
        "float16": (image / 255).astype(np.float16),
    }.get(kind, image.copy())
    given.flags.writeable = kind != "read only"
    found = Fitter(model).fit(given, start)
    np.testing.assert_allclose(found.landmarks, expected.landmarks, atol=0.05 if kind == "float16" else 0.0)


def laid_out(image: np.ndarray, offset: int, more: int) -> np.ndarray:
    """Return the same pixels, which begin at a byte of a buffer, with some bytes after each."""
    height, width, depth = image.shape
    by_pixel = depth * image.itemsize + more
    strides = (width * by_pixel, by_pixel, image.itemsize)
    moved = np.ndarray(image.shape, image.dtype, bytearray(offset + height * strides[0]), offset, strides)
    moved[...] = image
    return moved


LAYOUTS = {
    "odd strides": lambda image: laid_out(image, 0, 1),
    "one byte off": lambda image: laid_out(image, 1, 0),
    "one byte off with odd strides": lambda image: laid_out(image, 1, 3),
    "negative strides": lambda image: np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1],
    "big-endian": lambda image: image.astype(image.dtype.newbyteorder(">")),
    "read only": lambda image: np.frombuffer(image.tobytes(), image.dtype).reshape(image.shape),
    "columns first": np.asfortranarray,
    "little by little": lambda image: np.repeat(np.repeat(image, 2, axis=0), 3, axis=1)[::2, ::3],
}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_where_pixels_lie_in_memory_changes_no_bit(model, lit_scene, layout, dtype):
    """The core reads whole numbers and counts strides in numbers; what lies otherwise is copied at the door."""
    image = lit_scene.image if dtype == np.float32 else np.rint(lit_scene.image * np.iinfo(dtype).max)
    image = np.ascontiguousarray(image, dtype)
    given = LAYOUTS[layout](image)
    np.testing.assert_array_equal(given, image)
    fitter, start = Fitter(model, options=SHORT), disturb(lit_scene.landmarks)
    found, expected = fitter.fit(given, start), fitter.fit(image, start)
    np.testing.assert_array_equal(found.landmarks, expected.landmarks)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    for response in ("srgb", "linear"):
        np.testing.assert_array_equal(value_luminance(given, response), value_luminance(image, response))


def same_bits(one: list[FittedLevel], other: list[FittedLevel]) -> bool:
    names = ("p", "lam", "costs", "path", "angle_history", "expected_hessian", "usable", "weighted_contrast")
    return len(one) == len(other) and all(
        np.array_equal(getattr(a.solution, name), getattr(b.solution, name))
        for a, b in zip(one, other, strict=True)
        for name in names
    )


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no such timer")
@pytest.mark.parametrize("method", ["soft-li", "grey", "li"])
def test_a_fit_in_a_signal_handler_leaves_the_fit_that_it_interrupts_alone(
    model, fine_model, same_light_scene, lit_scene, method
):
    """Python runs handlers between two steps of a fit, on its thread: both fits have the bits of one alone."""
    other, levels = Fitter(fine_model, "rgb").coarse_to_fine, Fitter(model, method).coarse_to_fine
    other_target, _ = Fitter(fine_model, "rgb").target(same_light_scene.image, disturb(same_light_scene.landmarks))
    target, _ = Fitter(model, method).target(lit_scene.image, disturb(lit_scene.landmarks))
    alone, expected = levels.fit(target, SHORT), other.fit(other_target, SHORT)
    nested = []

    def fit_another(_, frame) -> None:
        if frame.f_code is CoarseToFine._call.__code__:
            signal.setitimer(signal.ITIMER_REAL, 0.0)  # once is enough
            nested.append(other.fit(other_target, SHORT))

    before = signal.signal(signal.SIGALRM, fit_another)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.0005, 0.0005)
        deadline = time.monotonic() + 60
        while not nested:  # a fit may end between two signals
            assert time.monotonic() < deadline
            assert same_bits(levels.fit(target, SHORT), alone)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert same_bits(nested[0], expected)


def test_ctrl_c_ends_a_fit(fine_model, lit_scene):
    """A fit that would take a quarter of an hour ends."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    objective = finest_objective(fine_model, "grey")
    image, p = make_level(fine_model, lit_scene.image, disturb(lit_scene.landmarks), objective)
    endless = SolverOptions(max_iterations=1_000_000, tolerance=0.0, damping=0.0)
    main, pressed = threading.main_thread().ident or 0, []

    def press():
        while sys._current_frames()[main].f_code is not type(objective).solve.__code__:
            time.sleep(0.01)
        time.sleep(0.1)  # from there into the core
        pressed.append(time.monotonic())
        _thread.interrupt_main()

    try:
        with pytest.raises(KeyboardInterrupt):
            state = objective.start(p)
            threading.Thread(target=press, daemon=True).start()
            objective.solve(image, state, endless)
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - pressed[0] < 60  # it did not run to its end


DAMAGED = {
    "a triangle that names no vertex": ("triangles", lambda a: a + 1000),
    "pixels that are not sorted": ("starts", lambda a: a[::-1].copy()),
    "modes at fewer pixels": ("modes", lambda a: a[:, :-1].copy()),
    "fewer parts of modes": ("modes", lambda a: np.concatenate([a, a])),
    "modes that are not padded": ("modes", lambda a: a[:, :, :-1].copy()),
    "fewer scales": ("mode_scales", lambda a: a[:-8].copy()),
    "fewer gradients": ("mode_gradients", lambda a: a[:, :-1].copy()),
    "a mean of another size": ("mean", lambda a: a[:, :-1].copy()),
    "a mean of three parts": ("mean", lambda a: np.repeat(a, 3, axis=0)),
    "a metric of another size": ("metric", lambda a: a[:, :-1].copy()),
    "another type": ("modes", lambda a: a.astype(np.float64)),
    "weights of another size": ("sqrt_weights", lambda a: a[:-1].copy()),
    "errors of another size": ("errors", lambda a: a[:-1].copy()),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_objectives_that_do_not_fit_together_are_refused(model, case):
    fields, (name, damage) = dict(finest_objective(model, "soft-li").fields), DAMAGED[case]
    fields[name] = damage(fields[name])
    with pytest.raises(ValueError):
        _core.make_objective(fields)


def test_a_state_of_another_size_is_refused(model, lit_scene):
    objective = finest_objective(model, "soft-li")
    image, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    with pytest.raises(ValueError, match="differs in size"):
        objective.solve(image, objective.start(p[:-1]), SolverOptions())
    smaller = replace(image, patch=replace(image.patch, channels=image.channels[:1]))
    with pytest.raises(ValueError, match="at least 2 by 2"):
        objective.solve(smaller, objective.start(p), SolverOptions())


def test_large_images_of_floats_are_fitted_level_by_level(model, lit_scene, monkeypatch):
    start = disturb(lit_scene.landmarks)
    whole = Fitter(model, "li").fit(lit_scene.image, start)
    monkeypatch.setattr("liaam.fitting.loop.levels.LARGEST_FLOATS", 10)
    fitter = Fitter(model, "li")
    assert not fitter.coarse_to_fine.can_take(fitter.target(lit_scene.image, start)[0], SolverOptions())
    again = Fitter(model, "li").fit(lit_scene.image, start)
    np.testing.assert_allclose(again.landmarks, whole.landmarks, atol=2e-2)


@pytest.mark.parametrize("choice", ["baseline", "numpy", "else"])
def test_the_instruction_set_can_be_forced(choice):
    code = "from liaam import _core; print(_core.INSTRUCTION_SET, _core.BUILT)"
    environment = {**os.environ, "LIAAM_CPU": choice, "LIAAM_REQUIRE_CORE": ""}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    if choice == "else":
        assert ran.returncode and "LIAAM_CPU=else is unknown; choose from baseline, avx2, numpy" in ran.stderr
    else:
        assert ran.stdout.split() == [choice, str(choice == "baseline")]
        assert not ran.stderr


def test_a_core_can_be_required():
    environment = {**os.environ, "LIAAM_CPU": "numpy", "LIAAM_REQUIRE_CORE": "1"}
    code = "import liaam._core"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert ran.returncode and "without its compiled core" in ran.stderr


def test_the_command_line_says_in_one_line_that_the_core_is_missing():
    code = """
import sys

class Blocker:
    def find_spec(self, name, *_):
        if name.startswith("liaam._core_"):
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Blocker())
sys.argv = ["liaam", "show", "face"]
from liaam.__main__ import main
main()
"""
    environment = {**os.environ, "LIAAM_CPU": "", "LIAAM_REQUIRE_CORE": ""}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert ran.returncode == 0 and "not compiled (NumPy)" in ran.stdout
    assert re.fullmatch(r"liaam was installed without its compiled core, .*\n", ran.stderr)


def test_without_a_core_one_message_without_a_path_says_how_to_get_it():
    code = """
import sys
sys.modules["liaam._core_baseline"] = sys.modules["liaam._core_avx2"] = None  # as if they were not installed
from liaam.cli.main import app
import liaam.fitting
"""
    environment = {name: value for name, value in os.environ.items() if name not in ("LIAAM_CPU", "LIAAM_REQUIRE_CORE")}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    (message,) = ran.stderr.splitlines()
    assert "without its compiled core" in message and "Install a C++ compiler" in message
    assert "/" not in message and "\\" not in message and ".py" not in message


def test_threads_that_are_still_at_work_do_not_abort_the_end_of_python():
    code = """
import threading
import numpy as np
from liaam import _core

image, at_work = np.zeros((1500, 1500), np.float32), threading.Semaphore(0)

def work():
    while True:
        _core.area_means(image, 700, 700)
        at_work.release()

for _ in range(3):
    threading.Thread(target=work, daemon=True).start()
for _ in range(9):
    at_work.acquire()
"""
    for _ in range(2):
        ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
        assert (ran.returncode, ran.stderr) == (0, "")


V3 = {"fma", "movbe", "f16c", "avx", "avx2", "bmi1", "bmi2", "abm"}
"""Flags of Linux for what ``-march=x86-64-v3`` may use beyond the baseline; ``abm`` stands for LZCNT."""


def test_the_second_set_is_chosen_where_all_of_it_runs():
    processor = Path("/proc/cpuinfo")
    if platform.machine() != "x86_64" or not processor.exists():
        pytest.skip("this system does not say what its processor runs")
    flags = set(re.findall(r"^flags\s*: (.*)$", processor.read_text(), re.MULTILINE)[0].split())
    baseline = importlib.import_module("liaam._core_baseline")
    assert baseline.best_instruction_set() == ("avx2" if flags >= V3 else "baseline")
