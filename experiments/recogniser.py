"""Does relighting help a recogniser that knows nothing of it? Needs ``dlib`` and the weights of its ResNet.

    python -m experiments.recogniser WEIGHTS TRAINING TEST LAMPS TRAINING_LAMP [--far 02 --far 12] [--diagonal 90]

WEIGHTS is ``dlib_face_recognition_resnet_model_v1.dat``. Every image of TEST under another light than that of training
is compared with the image of every person under the training light, by the distance of descriptors. Printed is the
equal error rate over these pairs, of images as taken and relit to the training light, and the ratio of the two with a
95 % interval from bootstrap samples of persons, the same for both. The landmarks of the data align the faces.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.generic import get_folds, get_trained, request_of_folders
from experiments.protocol import eight_bit
from liaam.relighting import Relighter

REPLICATES = 2000


def equal_error_rate(same: np.ndarray, other: np.ndarray) -> float:
    """Rate at which as many distances of the same person are too large as those of others are too small."""
    thresholds = np.sort(np.concatenate([same, other]))
    missed = 1.0 - np.searchsorted(np.sort(same), thresholds, side="right") / len(same)
    accepted = np.searchsorted(np.sort(other), thresholds, side="right") / len(other)
    at = np.argmin(np.abs(missed - accepted))
    return float(0.5 * (missed[at] + accepted[at]))


def rate_of(distances: np.ndarray, drawn: np.ndarray) -> float:
    """Equal error rate of distances (lights, persons, persons of the gallery) for drawn persons (n,)."""
    chosen = distances[:, drawn[:, None], drawn]
    same = drawn[:, None] == drawn
    return equal_error_rate(chosen[:, np.eye(len(drawn), dtype=bool)].ravel(), chosen[:, ~same].ravel())


def compare(taken: np.ndarray, relit: np.ndarray) -> str:
    """Equal error rates of two arrays of distances as in :func:`rate_of`, and their ratio with its interval."""
    every = np.arange(taken.shape[1])
    rates = [rate_of(each, every) for each in (taken, relit)]
    draws = np.random.default_rng(0).integers(len(every), size=(REPLICATES, len(every)))
    pairs = np.array([[rate_of(each, drawn) for each in (taken, relit)] for drawn in draws])
    low, high = np.nanquantile(pairs[:, 1] / np.where(pairs[:, 0] > 0, pairs[:, 0], np.nan), [0.025, 0.975])
    return f"{rates[0]:.3f} -> {rates[1]:.3f}, ratio {rates[1] / rates[0]:.2f} ({low:.2f} to {high:.2f})"


def descriptor(network, image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Describe a face with 68 landmarks (128,)."""
    import dlib  # pyright: ignore[reportMissingImports]

    (left, top), (right, bottom) = points.min(axis=0).astype(int).tolist(), points.max(axis=0).astype(int).tolist()
    parts = [dlib.point(*map(round, point)) for point in points.tolist()]
    face = dlib.full_object_detection(dlib.rectangle(left, top, right, bottom), parts)
    return np.array(network.compute_face_descriptor(np.ascontiguousarray(image), face))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the comparison."""
    import dlib  # pyright: ignore[reportMissingImports]

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("weights", "training", "test", "lamps"):
        parser.add_argument(name, type=Path)
    parser.add_argument("training_lamp")
    parser.add_argument("--far", action="append", default=[])
    parser.add_argument("--diagonal", type=float, default=90.0)
    given = parser.parse_args(arguments)
    network = dlib.face_recognition_model_v1(str(given.weights))
    request, _, _ = request_of_folders(given.training, given.test, given.lamps, given.training_lamp, given.diagonal)
    fitter, persons = get_trained(request, 0).fitters["soft-li"], get_folds(request)[0][0].tested
    found: dict[str, list[list[np.ndarray]]] = {}
    for pictures in persons.values():
        for light, sample, _ in pictures:
            image = eight_bit(sample)
            flat = Relighter.of(fitter, image, fitter.fit(image)).flat()
            both = [descriptor(network, each, sample.landmarks.points) for each in (image, flat)]
            found.setdefault(light, []).append(both)
    gallery = np.array(found.pop(given.training_lamp))
    far = [light for light in found if light in given.far]
    for name, lights in {"far": far, "other": [light for light in found if light not in far]}.items():
        shown = np.array([found[light] for light in lights])  # lights, persons, as taken and relit, 128
        distances = [np.linalg.norm(shown[:, :, None, i] - gallery[None, None, :, i], axis=-1) for i in (0, 1)]
        print(f"{name} ({', '.join(lights)}): equal error rate {compare(*distances)}")


if __name__ == "__main__":
    main()
