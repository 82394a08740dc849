"""Times of liaam's fits beside those of installed peers, and beside a lower bound.

All use one thread, bound to one core if possible. Trainable peers are trained on the same generated images. Peers with
their own face model are tested on photographs, if the shared data are available. Different models have different
points, so errors are reported only for liaam's landmarks.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import fit, iteration
from benchmarks.metrics import in_turn, quartiles, report
from benchmarks.track import data_folder
from benchmarks.trees import dlib_box, points_of, trained_trees
from experiments.lights import dapples, hard_light
from liaam import load_model
from liaam.datasets import Dataset, load_folder
from liaam.fitting import FitResult, Fitter
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import Objective
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.tracking import Tracker
from liaam.training import train

ROUNDS = 7
REPEATS = 8
"""Number of timings per round of calls that do not depend on the image."""

STEPS = 10
"""Difference in iterations between two fits, to time an iteration."""

MENPOFIT_ITERATIONS = 20
"""menpofit's default. Fewer, as soft-li takes, are too few for it."""

N_PHOTOGRAPHS = 8
"""Number of timed photographs. Detection uses all."""

EVERY_WILD = 4
"""Of the photographs in the wild, every fourth is timed."""

NODE_BYTES = 16
"""What a step along a linked list reads and writes in :func:`chase`: four numbers of four bytes."""

OPENCV = "pip install opencv-contrib-python-headless"

METHODS = ("soft-li", "li", "grey")
PLAIN, SPOT = "1", "5"
"""Conditions in ``imm``: diffuse light, and a spot light from the side."""

Call = Callable[[], Any]
Picture = fit.Picture


class Found(NamedTuple):
    """Number of faces found."""

    percent: float
    told: str


@dataclass(frozen=True)
class PeerRow:
    """One line of the table.

    Attributes
    ----------
    name : str
        Name of the metric, without its unit.
    what : str
        Description.
    calls : sequence of callables
        One for each image.
    less : sequence of callables
        The same with `steps` iterations less, to time an iteration rather than a call.
    steps : float
    beside : str
        Row to compare with: of liaam, or of MediaPipe for the face model.
    found : Found, optional
    varied : bool
        Whether the images differ so much that the mean and the largest of their medians are reported, too.
    """

    name: str
    what: str
    calls: Sequence[Call]
    less: Sequence[Call] = ()
    steps: float = 1
    beside: str = ""
    found: Found | None = None
    varied: bool = False


class MissingError(Exception):
    """A peer is not installed or lacks a feature; the message gives the reason."""


@dataclass(frozen=True)
class Peer:
    """A program to compare with.

    Attributes
    ----------
    name : str
    modules : tuple of str
        Required modules.
    install : str
        Command that installs it.
    rows : callable
        Returns its rows, or raises a `MissingError`.
    """

    name: str
    modules: tuple[str, ...]
    install: str
    rows: Callable[[], list[PeerRow]]


# ---- material


class Photographs(NamedTuple):
    """Faces of unseen persons."""

    lights: dict[str, list[Picture]]
    model: AAM


@cache
def photographs() -> Photographs | None:
    """Photographs under diffuse light, a spot light, and simulated hard light; None if there are no data."""
    folder = data_folder() / "imm"
    if not folder.is_dir():
        return None
    data = load_folder(folder).select(lambda sample: sample.name[:2] != "02")  # grey
    persons = sorted({sample.name[:2] for sample in data})

    def of(which: int, letters: str) -> Dataset:
        return data.select(lambda sample: persons.index(sample.name[:2]) % 2 == which and sample.name[3] in letters)

    plain, spot = ([(s.read_image(), s.landmarks.points) for s in of(1, letter)] for letter in (PLAIN, SPOT))
    laid = {
        name: [(light(image, shape, np.random.default_rng(i)), shape) for i, (image, shape) in enumerate(plain)]
        for name, light in (("hard", hard_light), ("dappled", dapples))
    }
    return Photographs(
        {"diffuse": plain, "spot": spot, **laid}, train(of(0, "12346"), leave_out=False, lamps=None, methods=METHODS)
    )


def known_photographs() -> Photographs:
    """Return the photographs, or raise a `MissingError`."""
    found = photographs()
    if found is None:
        raise MissingError("needs photographs, imm of the shared data (LIAAM_SHARED_DATA says where they are)")
    return found


def timed_photographs() -> list[Picture]:
    """Half in diffuse light, half under the spot."""
    lights = known_photographs().lights
    return lights["diffuse"][: N_PHOTOGRAPHS // 2] + lights["spot"][: N_PHOTOGRAPHS // 2]


@cache
def wild_photographs() -> list[np.ndarray]:
    """Photographs in the wild, of the shared data."""
    folder = data_folder() / "wild"
    if not folder.is_dir():
        raise MissingError("needs photographs, wild of the shared data (LIAAM_SHARED_DATA says where they are)")
    return [sample.read_image() for sample in list(load_folder(folder))[::EVERY_WILD]]


def found_faces(find: Callable[[np.ndarray], np.ndarray | None]) -> Found:
    """Count the faces found under each light.

    A face is found if the centre of the result's box is within a quarter of the face's diagonal of the true centre.
    """
    lights = known_photographs().lights
    hits = {name: [_near(find(image), shape) for image, shape in own] for name, own in lights.items()}
    told = ", ".join(f"{name} {sum(own)} of {len(own)}" for name, own in hits.items())
    return Found(100 * float(np.mean([hit for own in hits.values() for hit in own])), told)


def _near(points: np.ndarray | None, shape: np.ndarray) -> bool:
    if points is None:
        return False
    away = fit.box_of(points).reshape(2, 2).mean(axis=0) - fit.box_of(shape).reshape(2, 2).mean(axis=0)
    return bool(np.linalg.norm(away) < 0.25 * diagonal_of(shape))


# ---- the floor


def floor_bytes(objective: Objective, image: EncodedImage) -> int:
    """Minimum memory traffic of an iteration in bytes; see the table in benchmarks/README.md."""
    n, m, k = len(objective.appearance.mean), objective.n_lambda, objective.method.n_rows
    c = image.patch.n_channels
    seen = round(n * abs(np.linalg.det(image.from_model.matrix)))
    points = (12 + 16) * n
    sample = 4 * (c + 1) * seen + 4 * (c + 3 * k + 1) * n
    modes = 2 * m * k * n  # in 16 bits; once for the residual and once for the products
    return points + sample + 2 * modes + 12 * k * n


def floor_rows() -> list[PeerRow]:
    """Rows of the lower bound."""
    objective, _ = iteration.make_fit("li")
    n_columns = objective.warp.n_parameters
    rng = np.random.default_rng(1)
    what = f"BLAS products of the dense form alone, {iteration.N_PIXELS} pixels"
    rows = [PeerRow("peers_floor_blas", what, [iteration.make_yardstick(rng, n_columns)] * REPEATS)]
    for method in ("soft-li", "li"):
        n_bytes = floor_bytes(*iteration.make_fit(method))
        source = np.zeros(n_bytes // 2, np.uint8)
        what = f"reading and writing the {n_bytes / 1e6:.1f} MB that an iteration of {method} has to move"
        rows.append(
            PeerRow(f"peers_floor_move_{_word(method)}", what, [partial(np.copyto, source.copy(), source)] * REPEATS)
        )
    n_bytes = floor_bytes(*iteration.make_fit("soft-li"))
    what = f"a thousand steps along a linked list of {n_bytes / 1e6:.1f} MB in random order"
    n_nodes = n_bytes // NODE_BYTES
    return [*rows, PeerRow("peers_floor_chase", what, [chase(rng, n_nodes)] * REPEATS, steps=n_nodes / 1000)]


def chase(rng: np.random.Generator, n_nodes: int) -> Call:
    """Return a walk along a linked list whose nodes lie in random order: each step waits for the one before.

    It is a breadth-first search of a path, a compiled loop that NumPy does not have.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    order = rng.permutation(n_nodes).astype(np.int32)
    path = csr_array((np.ones(n_nodes - 1), (order[:-1], order[1:])), (n_nodes, n_nodes))
    return partial(breadth_first_order, path, order[0], return_predecessors=False)


# ---- liaam


def liaam_rows() -> list[PeerRow]:
    """Rows of whole fits, and of iterations with the pixels of the reference."""
    rows, pictures, model = [], _heads(), fit.make_model()
    for method in METHODS:
        word, fitter = _word(method), Fitter(model, method)
        results = head_fits(fitter)
        error = fit.median_error([result.landmarks for result in results], pictures, model.diagonal)
        steps = median_iterations(results)
        what = f"whole fit from a box, {model.n_pixels} pixels, {steps} iterations, {error:.2f} px off"
        rows.append(PeerRow(f"peers_liaam_{word}", what, fit.fits(fitter, pictures)))
        objective, problem = iteration.make_fit(method)
        loops = iteration.make_loops(objective, problem)
        what = f"one iteration, {iteration.N_PIXELS} pixels, rows: {objective.method.n_rows}"
        more, less = ([loops[name]] * REPEATS for name in ("more", "one"))
        name = f"peers_liaam_{word}_iteration"
        rows.append(PeerRow(name, what, more, less, iteration.STEPS, beside="peers_floor_blas"))
    return rows


def head_fits(fitter: Fitter) -> list[FitResult]:
    """Fits of the generated heads from their boxes."""
    return [fitter.fit(image, fit.box_of(shape)) for image, shape in _heads()]


def median_iterations(results: Sequence[FitResult]) -> int:
    """Median number of iterations of fits, over all levels."""
    return round(float(np.median([result.n_iterations for result in results])))


def photograph_rows() -> list[PeerRow]:
    """Rows of the default method on photographs of unseen persons."""
    pictures, model = timed_photographs(), known_photographs().model
    fitter = Fitter(model)
    trackers = [Tracker(model, init=shape) for _, shape in pictures]
    videos = [partial(tracker.update, image) for tracker, (image, _) in zip(trackers, pictures, strict=True)]
    searches = [partial(fitter.fit, image) for image, _ in pictures]
    finds = found_faces(lambda image: fitter.find(image)[0].landmarks)
    about = f"{model.n_pixels} pixels, {model.shape_model.n_points} points, photographs of 640x480"
    return [
        PeerRow("peers_liaam_photo", f"whole fit from a box, {about}", fit.fits(fitter, pictures)),
        PeerRow("peers_liaam_photo_found", "search and fit, photographs", searches, found=finds),
        PeerRow("peers_liaam_photo_video", "the next frame of a video that stands still, photographs", videos),
    ]


def face_rows() -> list[PeerRow]:
    """Rows of the face model that comes with liaam: frontal photographs, and photographs in the wild."""
    pictures = timed_photographs()
    fitter = Fitter(load_model("face"))
    n_pixels = fitter.model.n_pixels
    n_points = fitter.model.n_points
    about = f"the face model, {len(fitter.parts)} parts of {n_pixels} pixels, {n_points} points"
    still = "peers_mediapipe_still"
    searches = [partial(fitter.fit, image) for image, _ in pictures]
    wild = [partial(fitter.fit, image) for image in wild_photographs()]
    return [
        PeerRow(
            "peers_liaam_face", f"whole fit from a box, {about}, photographs", fit.fits(fitter, pictures), beside=still
        ),
        PeerRow("peers_liaam_face_found", f"search and fit, {about}, photographs", searches, beside=still),
        PeerRow(
            "peers_liaam_face_wild",
            f"search and fit, {about}, {len(wild)} photographs in the wild",
            wild,
            beside="peers_mediapipe_wild",
            varied=True,
        ),
    ]


# ---- dlib


def dlib_rows() -> list[PeerRow]:
    """Rows of the shape predictor: its own model on photographs, and one trained on the generated heads."""
    return [dlib_trained(), *dlib_photographs()]


def dlib_trained() -> PeerRow:
    """A predictor of liaam's landmarks."""
    training, pictures = fit.make_pictures()
    predictor = trained_trees(training)
    calls = [partial(predictor, image, dlib_box(shape)) for image, shape in pictures]
    shapes = [points_of(call().parts()) for call in calls]
    error = fit.median_error(shapes, pictures, fit.make_model().diagonal)
    what = f"regression trees trained on the same {len(training)} heads, from a box, {error:.2f} px off"
    return PeerRow("peers_dlib_trained", what, calls, beside="peers_liaam_soft_li")


def dlib_photographs() -> list[PeerRow]:
    """The 68 points, and the detector that they start from."""
    dlib: Any = __import__("dlib")
    pictures = timed_photographs()
    predictor, detector = dlib.shape_predictor(str(dlib_model())), dlib.get_frontal_face_detector()

    def find(image: np.ndarray) -> np.ndarray | None:
        boxes = sorted(detector(image), key=lambda box: -box.area())
        return np.array([(boxes[0].left(), boxes[0].top()), (boxes[0].right(), boxes[0].bottom())]) if boxes else None

    points = [partial(predictor, image, dlib_box(shape)) for image, shape in pictures]
    faces = [partial(detector, image) for image, _ in pictures]
    return [
        PeerRow(
            "peers_dlib_68", "regression trees, 68 points from a box, photographs", points, beside="peers_liaam_photo"
        ),
        PeerRow("peers_dlib_detect", "frontal face detector, photographs", faces, found=found_faces(find)),
    ]


def dlib_model() -> Path:
    """Path of the 68-point model in ``face_recognition_models``, whose own module needs an old setuptools."""
    spec = find_spec("face_recognition_models")
    if spec is None or not spec.submodule_search_locations:
        raise MissingError("the file of its 68 points is not installed")
    return Path(spec.submodule_search_locations[0]) / "models" / "shape_predictor_68_face_landmarks.dat"


# ---- MediaPipe


def mediapipe_rows() -> list[PeerRow]:
    """Rows of the face mesh on photographs: as single images, and as frames of a video."""
    from mediapipe.python.solutions.face_mesh import FaceMesh  # type: ignore

    pictures = timed_photographs()
    still = FaceMesh(static_image_mode=True)
    videos = [FaceMesh(static_image_mode=False) for _ in pictures]

    def find(image: np.ndarray) -> np.ndarray | None:
        faces = still.process(image).multi_face_landmarks
        return np.array([(p.x, p.y) for p in faces[0].landmark]) * image.shape[1::-1] if faces else None

    each = [partial(still.process, image) for image, _ in pictures]
    wild = [partial(still.process, image) for image in wild_photographs()]
    frames = [partial(video.process, image) for video, (image, _) in zip(videos, pictures, strict=True)]
    return [
        PeerRow(
            "peers_mediapipe_still",
            "face mesh, detection and 468 points, photographs",
            each,
            beside="peers_liaam_photo_found",
            found=found_faces(find),
        ),
        PeerRow("peers_mediapipe_wild", f"the same on {len(wild)} photographs in the wild", wild, varied=True),
        PeerRow(
            "peers_mediapipe_video",
            "face mesh, the next frame of a video that stands still, photographs",
            frames,
            beside="peers_liaam_photo_video",
        ),
    ]


# ---- menpofit


def menpofit_rows() -> list[PeerRow]:
    """Rows of its active appearance models, on grey values and on gradient orientations."""
    from menpo.feature import igo, no_op  # type: ignore

    return [*menpofit_feature("grey", no_op), *menpofit_feature("igo", igo)]


def menpofit_feature(word: str, feature: Callable) -> list[PeerRow]:
    """The rows of a feature: a whole fit, and one iteration."""
    diagonal = fit.make_model().diagonal
    fitter = menpofit_fitter(feature, diagonal, (0.5, 1.0))
    calls = menpofit_calls(fitter, MENPOFIT_ITERATIONS)
    error = fit.median_error([call().final_shape.points[:, ::-1] for call in calls], _heads(), diagonal)
    what = f"whole fit from a box, {_pixels(fitter)} pixels, {MENPOFIT_ITERATIONS} iterations, {error:.2f} px off"
    beside = {"grey": "peers_liaam_grey", "igo": "peers_liaam_soft_li"}[word]
    single = menpofit_fitter(feature, diagonal, (1.0,))
    exact = menpofit_fitter(feature, diagonal * np.sqrt(iteration.N_PIXELS / _pixels(single)), (1.0,))
    exact.algorithms[0].eps = -1.0  # continues after convergence
    what_iteration = f"one iteration, {_pixels(exact)} pixels, channels: {1 if word == 'grey' else 2}"
    more, less = menpofit_calls(exact, 1 + STEPS), menpofit_calls(exact, 1)
    name = f"peers_menpofit_{word}"
    return [
        PeerRow(name, what, calls, beside=beside),
        PeerRow(f"{name}_iteration", what_iteration, more, less, STEPS, beside=f"{beside}_iteration"),
    ]


@cache
def menpofit_fitter(feature: Callable, diagonal: float, scales: tuple[float, ...]):
    """A fitter trained on the same heads, with as many modes as ours."""
    from menpofit.aam import HolisticAAM, LucasKanadeAAMFitter  # type: ignore

    model = fit.make_model()
    counts = {
        "max_shape_components": len(model.shape_model.modes),
        "max_appearance_components": len(model.levels[-1].appearances["value"].modes),
    }
    images = [menpo_image(image, shape) for image, shape in fit.make_pictures()[0]]
    aam = HolisticAAM(images, group="PTS", holistic_features=feature, diagonal=diagonal, scales=scales, **counts)
    return LucasKanadeAAMFitter(aam)


def menpofit_calls(fitter, n_iterations: int) -> Sequence[Call]:
    """Fits of the heads from their boxes."""
    from menpo.shape import bounding_box  # type: ignore

    calls = []
    for image, shape in _heads():
        box = fit.box_of(shape[:, ::-1])
        start = bounding_box(box[:2], box[2:])
        calls.append(partial(fitter.fit_from_bb, menpo_image(image), start, max_iters=n_iterations))
    return calls


def menpo_image(image: np.ndarray, shape: np.ndarray | None = None):
    """Make a grey menpo image, whose points are (row, column)."""
    from menpo.image import Image  # type: ignore
    from menpo.shape import PointCloud  # type: ignore

    made = Image(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[None] / 255.0)
    if shape is not None:
        made.landmarks["PTS"] = PointCloud(shape[:, ::-1])
    return made


def _pixels(fitter) -> int:
    """Pixels of the sharpest scale."""
    return int(fitter.algorithms[-1].template.n_true_pixels())


# ---- OpenCV


def opencv_rows() -> list[PeerRow]:
    """Rows of its active appearance model, with a model file made from the same heads."""
    if not hasattr(getattr(cv2, "face", None), "createFacemarkAAM"):
        raise MissingError(f"this OpenCV is without its contributed modules ({OPENCV})")
    from benchmarks import peer_opencv

    model = fit.make_model()
    n_modes = len(model.levels[-1].appearances["value"].modes)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "aam.yaml"
        n_pixels = peer_opencv.write_model(path, model, fit.make_pictures()[0], n_modes)
        fitted = peer_opencv.BoxFit(path, model)
    calls = [partial(fitted, image, fit.box_of(shape)) for image, shape in _heads()]
    error = fit.median_error([call() for call in calls], _heads(), model.diagonal)
    n = peer_opencv.ITERATIONS
    what = f"whole fit from a box, {n_pixels} pixels, {n} iterations, {error:.2f} px off"
    name, each = "peers_opencv_aam", f"a {n}th of it, set-up included, {n_pixels} pixels"
    return [
        PeerRow(name, what, calls, beside="peers_liaam_grey"),
        PeerRow(f"{name}_iteration", each, calls, steps=n, beside="peers_liaam_grey_iteration"),
    ]


# ---- the table

PEERS = (
    Peer("floor", (), "", floor_rows),
    Peer("liaam", (), "", liaam_rows),
    Peer("liaam on photographs", (), "", photograph_rows),
    Peer("liaam's face model", (), "", face_rows),
    Peer("dlib", ("dlib",), "pip install dlib-bin face_recognition_models", dlib_rows),
    Peer("MediaPipe", ("mediapipe",), "pip install mediapipe==0.10.21", mediapipe_rows),
    Peer("OpenCV", ("cv2",), OPENCV, opencv_rows),
    Peer("menpofit", ("menpofit",), "pip install menpofit==0.7.1 'numpy<2' 'scipy<1.14'", menpofit_rows),
)


def rows_of(peer: Peer) -> list[PeerRow]:
    """Return a peer's rows, or print why there are none."""
    lacking = [name for name in peer.modules if find_spec(name) is None]
    reason = f"not installed ({peer.install})"
    if not lacking:
        try:
            return peer.rows()
        except MissingError as fault:
            reason = str(fault)
        except ImportError as fault:
            reason = f"installed, but cannot be imported: {fault} ({peer.install})"
    print(f"  {peer.name}: not measured; {reason}", flush=True)
    return []


@contextmanager
def one_core() -> Iterator[None]:
    """Bind this thread, and all threads that it starts, to one core, if the system supports it."""
    os.environ.setdefault("GLOG_minloglevel", "2")  # reduce MediaPipe's output
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        if not hasattr(os, "sched_setaffinity"):
            yield
            return
        allowed = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {max(allowed)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, allowed)


def measure(rows: Sequence[PeerRow]) -> dict[str, np.ndarray]:
    """Milliseconds of each row, (rounds, images)."""
    blocks = {row.name: row.calls for row in rows} | {f"less {row.name}": row.less for row in rows if row.less}
    times = in_turn(blocks, ROUNDS)
    return {
        row.name: ((times[row.name] - times[f"less {row.name}"]) if row.less else times[row.name]) / row.steps
        for row in rows
    }


def main() -> None:
    """Print the metrics of all installed peers."""
    print("fits beside peers: generated heads and photographs of 640x480 pixels, 1 core")
    with one_core():
        rows = [row for peer in PEERS for row in rows_of(peer)]
        times = measure(rows)
    for row in rows:
        own = times[row.name]
        note = f"({quartiles(own, '.3f')}; {row.what})"
        report(f"{row.name}_ms", float(np.median(own)), note, width=40)
        if row.varied:
            of_images = np.median(own, axis=0)
            report(f"{row.name}_mean_ms", float(of_images.mean()), "(mean over the images)", width=40)
            report(f"{row.name}_most_ms", float(of_images.max()), "(of the slowest image)", width=40)
    for row in rows:
        if row.beside in times:
            ratio = float(np.median(times[row.name]) / np.median(times[row.beside]))
            report(f"{row.name}_ratio", ratio, f"(of {row.beside}_ms)", width=40)
    for row in rows:
        if row.found is not None:
            report(f"{row.name}_percent", row.found.percent, f"(found; {row.found.told})", form=".0f", width=40)


def _heads() -> list[Picture]:
    return fit.make_pictures()[1]


def _word(method: str) -> str:
    return method.replace("-", "_")


if __name__ == "__main__":
    main()
