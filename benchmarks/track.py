"""Accuracy, jitter and speed of tracking a talking face, also under a moving light.

The video is FGnet's Talking Face, 4,800 frames without landmarks, as ``video/talking-face.mp4`` of the shared data. A
generic model of ``imm`` is fitted to some of its frames. The best fits train a model of this person, which tracks the
video.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter, thread_time

import cv2
import numpy as np

from benchmarks.metrics import report
from experiments.lights import circling_light
from liaam.datasets import load_folder
from liaam.fitting import FitResult, Fitter
from liaam.io import Contour, Landmarks, VideoFrame, VideoReader
from liaam.model import AAM
from liaam.tracking import TrackedFrame, Tracker
from liaam.tracking.shading import ShadingRemover
from liaam.training import train

FRAMES = 300
"""Number of tracked frames; the argument of ``python -m benchmarks.track`` (4800: all)."""

LOOKED_AT, TRAINED_ON = 48, 16
"""Numbers of frames that the generic model is fitted to, and that train the person's model."""

PERIOD = 72
"""Period of the lamp's swing in frames: three seconds."""

EYES = (slice(13, 21), slice(21, 29))
"""Landmarks of the two eyes."""

METHODS = ("soft-li", "li", "rgb", "grey")
"""Methods that track the relit video."""

LOST = 8.0
"""Error above which a frame counts as lost, in per cent of the distance between the eyes."""


def data_folder() -> Path:
    """Return the folder of the shared data."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("LIAAM_SHARED_DATA", beside))


def generic_model(folder: Path) -> AAM:
    """Train a model on frontal images of many persons, except the second, whose images are grey."""
    data = load_folder(folder / "imm").select(lambda sample: sample.name[:2] != "02" and sample.name[3] in "126")
    return train(data, diagonal=120, lamps=None, methods=METHODS)


def person_model(generic: AAM, video: Path) -> AAM:
    """Train a model of the person in a video, from fits of a generic model to frames spread over it."""
    with VideoReader(video) as frames:
        step = max(1, (frames.n_frames or LOOKED_AT) // LOOKED_AT)
        images = [frame.image for frame in frames if frame.index % step == step // 2]
    fitter = Fitter(generic)
    fits = [fitter.fit(image) for image in images]
    # Take the best of each part, so that they are spread over the video.
    stretches = np.array_split(np.arange(len(fits)), TRAINED_ON)
    best = [max(stretch, key=lambda i: fits[i].quality) for stretch in stretches if len(stretch)]
    contours = tuple(Contour(indices, closed) for indices, closed in generic.contours)
    return train(
        [(images[i], Landmarks(fits[i].landmarks, contours)) for i in best], diagonal=120, lamps=None, methods=METHODS
    )


def run(tracker: Tracker, frames: Sequence[VideoFrame], light: Callable | None = None) -> list[TrackedFrame]:
    """Track frames, under another light if there is one."""
    return [tracker.update(light(frame) if light else frame.image) for frame in frames]


def eye_distance(shapes: np.ndarray) -> np.ndarray:
    """Distance between the eyes' centres of shapes (..., n, 2)."""
    left, right = (shapes[..., eye, :].mean(axis=-2) for eye in EYES)
    return np.linalg.norm(left - right, axis=-1)


def stacked(frames: Sequence[TrackedFrame], name: str) -> np.ndarray:
    """Landmarks of all frames, (frames, n, 2)."""
    return np.array([getattr(frame, name) for frame in frames])


def differences(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean distance of landmarks from those of b, in per cent of b's eye distance, (frames,); 100 if lost."""
    away = 100 * np.linalg.norm(a - b, axis=2).mean(axis=1) / eye_distance(b)
    return np.nan_to_num(away, nan=100.0)


def trembling(shapes: np.ndarray) -> float:
    """Root mean square second difference over time, pixels."""
    return float(np.sqrt(np.nanmean(np.square(np.diff(shapes, 2, axis=0)))))


def overhead(model: AAM, video: Path, results: Sequence[FitResult], n: int = 1000) -> tuple[float, float]:
    """Processor and wall-clock time per frame without the fits, in milliseconds.

    The first is of the tracker's thread. The second includes waiting for the decoder.
    """
    tracker = Tracker(model, init=results[0].landmarks)
    count = 0

    def remembered(*_: object) -> FitResult:
        nonlocal count
        count += 1
        back_and_forth = count % (2 * len(results) - 2)
        return results[min(back_and_forth, 2 * len(results) - 2 - back_and_forth)]

    for fitter in (tracker.fitter, tracker._near):
        object.__setattr__(fitter, "fit", remembered)
    with VideoReader(video, stop=n) as frames:
        seen, before, spent = 0, perf_counter(), thread_time()
        for frame in frames:
            tracker.update(frame.image)
            seen += 1
    return 1e3 * (thread_time() - spent) / seen, 1e3 * (perf_counter() - before) / seen


def flicker(model: AAM, pictures: Iterator[np.ndarray], shapes: np.ndarray) -> float:
    """Median over the object's pixels of the second difference over time of grey values, of 255."""
    inner = model.warp.interpolate
    rows = []
    for picture, shape in zip(pictures, shapes, strict=False):
        x, y = inner(shape).astype(np.float32).T[:, :, None]
        rows.append(cv2.remap(picture.mean(axis=2).astype(np.float32), x, y, cv2.INTER_LINEAR)[:, 0])
    return float(np.median(np.abs(np.diff(np.array(rows), 2, axis=0)).mean(axis=0)))


def relit(frames: Sequence[VideoFrame], shapes: np.ndarray) -> list[VideoFrame]:
    """Relight the frames with a moving lamp."""
    return [
        VideoFrame(frame.index, frame.time, circling_light(frame.image, shape, i / PERIOD))
        for i, (frame, shape) in enumerate(zip(frames, shapes, strict=True))
    ]


def measure(model: AAM, video: Path, n: int) -> None:
    """Print the metrics of a model that tracks a video's first frames."""
    with VideoReader(video, stop=n) as reader:
        frames = list(reader)
    results: list[FitResult] = []
    tracker = Tracker(model)
    tracker.update(frames[0].image)  # prepares the fitters
    tracker.reset()
    with VideoReader(video, stop=n) as reader:
        before, spent, tracked = perf_counter(), thread_time(), []
        for frame in reader:
            tracked.append(tracker.update(frame.image, frame.time, frame.index))
            if tracker.result is not None and len(results) < 30:
                results.append(tracker.result)
        seconds, busy = perf_counter() - before, thread_time() - spent
    raw, smooth = stacked(tracked, "raw"), stacked(tracked, "landmarks")
    lost = sum(not frame.ok for frame in tracked)
    report("track_lost", lost, f"of {len(tracked)}", form=".0f")
    report("track_quality", float(np.median([frame.quality for frame in tracked])))
    own_rate = f"of one core {len(tracked) / busy:.1f}"
    report("track_frames_per_second", len(tracked) / seconds, own_rate, form=".1f")
    own_part, whole = overhead(model, video, results)
    report("track_overhead_ms", own_part, f"waiting included {whole:.2f}", form=".2f")
    report("track_trembling_px", trembling(smooth), f"unsmoothed {trembling(raw):.3f}")
    seen = [i for i, frame in enumerate(tracked) if frame.ok]
    frames, smooth = [frames[i] for i in seen], smooth[seen]
    lit = relit(frames, smooth)
    for method in METHODS:
        found = stacked(run(Tracker(model, method, init=smooth[0]), lit), "landmarks")
        away = differences(found, smooth)
        beyond = f"lost {100 * (away > LOST).mean():.1f} %"
        report(f"track_relit_{method}", float(np.median(away)), beyond, form=".2f")
    shading(model, frames[: 2 * PERIOD], lit[: 2 * PERIOD], smooth)


def shading(model: AAM, frames: Sequence[VideoFrame], lit: Sequence[VideoFrame], smooth: np.ndarray) -> None:
    """Print how the shading-free version of a relit video flickers, that video, and the one without the lamp."""
    tracker = Tracker(model, init=smooth[0])
    remover = ShadingRemover(tracker.fitter)

    def fresh() -> Iterator[np.ndarray]:
        for frame in lit:
            tracked, result = tracker.update(frame.image), tracker.result
            yield frame.image if result is None else remover.remove(frame.image, result, tracked.landmarks)

    own, before = (flicker(model, (frame.image for frame in video), smooth) for video in (frames, lit))
    others = f"with shading {before:.2f} without the lamp {own:.2f}"
    report("track_flicker", flicker(model, fresh(), smooth), others, form=".2f")


def main(n: int = FRAMES) -> None:
    """Print all metrics, or that there are no data."""
    folder = data_folder()
    video = folder / "video" / "talking-face.mp4"
    if not video.exists() or not (folder / "imm").is_dir():
        print(f"track: needs imm and video/talking-face.mp4 in {folder} (or LIAAM_SHARED_DATA); left out")
        return
    cv2.setNumThreads(1)
    measure(person_model(generic_model(folder), video), video, n)


if __name__ == "__main__":
    import sys

    main(int(sys.argv[1]) if len(sys.argv) > 1 else FRAMES)
