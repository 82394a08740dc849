"""Fixtures shared by all tests: seeds from test names, a simulated world with known truth, and real data."""

import gc
import hashlib
import os
import random
import sys
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache, partial
from pathlib import Path

# Before anything is imported that looks at these. Tests that run side by side ('pytest -n logical') leave each other's
# cores alone; and how wide tables are printed is what a test says, not who runs it.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("COLUMNS", None)

import numpy as np
import pytest
import typer.main
from hypothesis import settings

import setups
from experiments import cli as experiments_cli
from liaam.cli.main import main as liaam_main
from liaam.datasets import Sample, load_folder
from liaam.io import Landmarks, video_writer
from liaam.model import AAM, SURROUNDINGS, load_model
from liaam.training import LearntLamps, learn_lamps, train
from scenes import (
    DIFFUSE,
    Head,
    Scene,
    lateral,
    make_set,
    narrow_band_camera,
    random_expression,
    random_pose,
    render,
)
from scenes.chart import CONTOURS
from setups import MOVING_FRAMES, between, moving_scene, one_at_a_time, train_on

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = Path(os.environ.get("LIAAM_SHARED_DATA", ROOT.parent / "shared" / "data"))
TRAINED = os.environ.get("LIAAM_TRAINED")  # a folder that keeps trained models and scenes for another run of the tests
SCENE_SIZE = (240, 180)

# The same examples in every run, and no limit on the time of one: the first loads what it needs, and the machine may be
# busy (so too_slow is no fault in tests either). The fuzzer tries thousands more.
settings.register_profile("liaam", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("liaam")


# Files that take long, the longest first: a worker that begins one of them last leaves the others idle.
LONG = (
    "test_docs.py",
    "test_live_tab.py",
    "test_fit_tab.py",
    "test_begin.py",
    "test_background_training.py",
    "test_simulated.py",
    "test_search.py",
    "test_tracker.py",
    "test_cli_video.py",
    "test_registration.py",
    "test_label_faults.py",
    "test_cli_camera.py",
    "test_demo.py",
    "test_real_faces.py",
    "test_sets.py",
    "test_scenes.py",
    "test_training.py",
    "test_repeatable.py",
    "test_experiments_cli.py",
    "test_cli.py",
    "test_cli_folders.py",
    "test_symmetry.py",
    "test_faces.py",
    "test_background.py",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--shuffle", type=int, metavar="SEED", help="run the files, and the tests of each, in random order"
    )


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the files that take long; or shuffle files, and the tests of each.

    The order is the same in all processes, which have to agree on it.
    """
    seed = config.getoption("shuffle")
    if seed is None:
        places = {name: place for place, name in enumerate(LONG)}
        items.sort(key=lambda item: places.get(item.path.name, len(LONG)))
        return
    tests_of = defaultdict(list)
    for item in items:
        tests_of[item.path].append(item)
    order, shuffled = random.Random(seed), list(tests_of.values())
    order.shuffle(shuffled)
    for tests in shuffled:
        order.shuffle(tests)
    items[:] = [item for tests in shuffled for item in tests]


def pytest_collection() -> None:
    """Collect no garbage while tests are collected: nothing of it is, and each pass looks through all of them."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Collect garbage from now on, and leave out what collection has made."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep the tests of a file on one worker: they share what is long in the making."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # by the number of tests, which says little of their time
    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory) -> Path:
    """Give a folder that all workers share."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


def save_scene(path: Path, scene: Scene) -> None:
    """Write a scene as one record, without its contours, which all scenes share; the file is whole when it is there."""
    values = {f.name: np.asarray(getattr(scene, f.name)) for f in fields(scene) if f.name != "contours"}
    record = np.zeros((), [(name, value.dtype, value.shape) for name, value in values.items()])
    for name, value in values.items():
        record[name] = value
    new = path.with_suffix(".half.npy")
    np.save(new, record, allow_pickle=False)
    new.replace(path)


def load_scene(path: Path) -> Scene:
    record = np.load(path, allow_pickle=False)
    values = {name: record[name].copy() for name in record.dtype.names if name != "theta"}
    return Scene(**values, theta=float(record["theta"]), contours=CONTOURS)


@pytest.fixture(autouse=True, scope="session")
def rendered_once(shared_folder) -> Iterator[None]:
    """Render each picture of a set, a clip or a person once for all tests and workers: many are of the same head."""
    folder = Path(TRAINED) if TRAINED else shared_folder

    def once(*arguments, **options) -> Scene:
        path = folder / f"{hashlib.sha256(repr((arguments, options)).encode()).hexdigest()}.npy"
        if not path.exists():
            with one_at_a_time(path):
                if not path.exists():
                    save_scene(path, render(*arguments, **options))
        return load_scene(path)

    with pytest.MonkeyPatch.context() as patch:
        for module in (sys.modules["scenes.render"], setups):
            patch.setattr(module, "render", once)
        yield


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Give a generator seeded from the test's own name: stable, and different for each test."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Give the folder of real images; tests that need it skip where it is absent (CI always has it)."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real images are not at {SHARED_DATA} (set LIAAM_SHARED_DATA)")
    return SHARED_DATA


@pytest.fixture(scope="session")
def scenes() -> list[Scene]:
    """Give eight pictures of one head under diffuse light by the paper's ideal camera: linear floats, no noise."""
    return make_set(8, Head(7), DIFFUSE, narrow_band_camera(), seed=1, size=SCENE_SIZE, mixing="planckian")


def _held_out(lights) -> Scene:
    """Take the same head with a pose and an expression half-way between two of the training pictures."""
    draws = [np.random.default_rng([1, i, 0x5E7]) for i in (1, 4)]
    poses = [random_pose(draw, SCENE_SIZE) for draw in draws]
    expressions = [random_expression(draw) for draw in draws]
    camera = narrow_band_camera()
    return render(Head(7), between(*poses), between(*expressions), lights, camera, SCENE_SIZE, mixing="planckian")


@pytest.fixture(scope="session")
def lit_scene() -> Scene:
    """Give a held-out picture of the same head under hard light from the side, of another temperature."""
    return _held_out(lateral("left"))


@pytest.fixture(scope="session")
def same_light_scene() -> Scene:
    """Give a held-out picture of the same head under the light of the training pictures."""
    return _held_out(DIFFUSE)


@pytest.fixture(scope="session")
def lamps() -> LearntLamps:
    """Learn three lamps from two pictures of the same head, for the methods that learn what light does."""
    lights = (DIFFUSE, lateral("left"), lateral("right"), lateral("left", azimuth=0.5, elevation=0.7))
    options = {"camera": narrow_band_camera(), "seed": 20, "size": SCENE_SIZE, "mixing": "planckian"}
    shown = [
        Sample(f"{i}-{lamp}", scene.image, Landmarks(scene.landmarks))
        for lamp, light in enumerate(lights)
        for i, scene in enumerate(make_set(2, Head(7), light, **options))
    ]
    return learn_lamps(shown, "0", response="linear")


@pytest.fixture(scope="session")
def trained_once(shared_folder) -> Callable[[str, Callable[[], AAM]], AAM]:
    """Train a model once for all workers: the first that needs it trains, the others wait and read its file."""

    def model_of(name: str, make: Callable[[], AAM]) -> AAM:
        path = (Path(TRAINED) if TRAINED else shared_folder) / f"{name}.liaam"
        with one_at_a_time(path):
            if not path.exists():
                make().save(path)
        return load_model(path)

    return model_of


@pytest.fixture(scope="session")
def model(trained_once, request) -> AAM:
    """Give a small model (diagonal 80) of the scenes, with all appearances that there are."""
    needed = request.getfixturevalue
    return trained_once("small", lambda: train_on(needed("scenes"), diagonal=80.0, lamps=needed("lamps")))


@pytest.fixture(scope="session")
def fine_model(trained_once, scenes) -> AAM:
    """Give a model (diagonal 150) of the scenes that keeps all modes."""
    return trained_once("fine", lambda: train_on(scenes, diagonal=150.0, variance=1.0))


@pytest.fixture(scope="session")
def shells(shared_data, trained_once) -> tuple[AAM, list[Sample]]:
    """Give a model of 40 real shells of many species, and the shells that it was not trained on."""
    samples = list(load_folder(shared_data / "shells"))
    order = np.random.default_rng(0).permutation(len(samples))
    model = trained_once("shells", lambda: train([samples[i] for i in order[:40]]))
    return model, [samples[i] for i in order[40:]]


@pytest.fixture(scope="session")
def moving() -> list[Scene]:
    """Give the frames of a head that turns and talks, as an ordinary camera sees it: 8 bits, broad sensors.

    It goes back as it came, so that half of the frames need no rendering.
    """
    there = [moving_scene(i / MOVING_FRAMES) for i in range(MOVING_FRAMES // 2 + 1)]
    return [*there, *there[-2:0:-1]]


@pytest.fixture(scope="session")
def head_model(trained_once) -> AAM:
    """Give a small model of the head that moves, with calibrated reliability."""
    return trained_once("head", _head_model)


def _head_model() -> AAM:
    scenes = [*make_set(8, Head(5), size=(160, 120)), *(moving_scene(time) for time in (0.03, 0.27, 0.53, 0.78))]
    # As blurred as a large frame's: what is asked of tracks was measured with such fits' noise.
    blurs = {SURROUNDINGS: (4.0, 2.0, 1.0)}
    return train([(scene.image, scene.landmarks) for scene in scenes], diagonal=60.0, blurs=blurs, methods="all")


@pytest.fixture(scope="session")
def clip(moving, tmp_path_factory) -> Path:
    """Give the frames of the head that moves as an mp4."""
    path = tmp_path_factory.mktemp("clip") / "talk.mp4"
    with video_writer(path, 25) as writer:
        for scene in moving:
            writer.write(scene.image)
    return path


@pytest.fixture
def run(monkeypatch, capsys):
    """Run 'liaam ...' in this process; gives (exit status, standard output, standard error)."""
    return partial(_run, liaam_main, monkeypatch, capsys)


@pytest.fixture
def run_experiments(monkeypatch, capsys):
    """Run 'python -m experiments ...' likewise."""
    return partial(_run, experiments_cli.main, monkeypatch, capsys)


_command_of = cache(typer.main.get_command)
"""Makes the commands of a command line once, instead of at each run: all their options take 25 ms."""


def _run(main, monkeypatch, capsys, *arguments):
    monkeypatch.setattr(typer.main, "get_command", _command_of)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "argv", [main.__module__, *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        main()
        raise SystemExit(0)
    captured = capsys.readouterr()
    return stopped.value.code or 0, captured.out, captured.err


NOTHING = {
    "no rows": np.zeros((0, 9, 3), np.uint8),
    "one pixel": np.zeros((1, 1), np.float32),
    "black": np.zeros((200, 300, 3), np.uint8),
    "no values": np.full((200, 300), np.nan, np.float32),
    "huge values": np.full((200, 300), 1e38, np.float32),
    "endless values": np.full((200, 300), np.inf, np.float32),
    "two rows": np.zeros((2, 3000), np.uint8),
}


@pytest.fixture(params=NOTHING.values(), ids=NOTHING)
def image_of_nothing(request: pytest.FixtureRequest) -> np.ndarray:
    """Give images in which there is nothing to find, one after the other."""
    return request.param
