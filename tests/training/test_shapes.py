"""Models of several kinds of shape: how images are grouped, and that each kind is found, fitted and tracked."""

from dataclasses import replace

import numpy as np
import pytest

import liaam
from liaam import Landmarks, Sample
from liaam.cli.check import faults_by_sample
from liaam.error_measures import point_error
from liaam.errors import ModelFileError, TrainingError
from liaam.fitting import Finder
from liaam.fitting.solution import residual_at
from liaam.io import write_image
from liaam.model.shape import align, diagonal_of, rotation
from liaam.relighting import Relighter
from liaam.training.shapes import procrustes_distances, shape_groups
from setups import BODY, TexturedObject

OTHER = BODY + np.array([[0, 8], [8, 0], [0, -9], [9, 0], [0, 9], [-9, 0], [0, 7], [6, 0]])
SIZE = (110, 90)
QUICK = {"lamps": None, "copies": 0, "diagonal": 50, "leave_out": False, "sides": "one"}


def shapes_of(rng, count: int, mean: np.ndarray = BODY, spread: float = 0.6) -> np.ndarray:
    """Draw shapes at any position, size and small rotation."""
    drawn = []
    for deviation in rng.normal(0.0, spread, (count, *mean.shape)):
        turned = (mean + deviation) @ rotation(rng.normal(0.0, 0.1)).T
        drawn.append(rng.uniform(0.9, 1.1) * turned + rng.uniform(20, 24, 2))
    return np.array(drawn)


def bent_at_the_middle(shape: np.ndarray, angle: float) -> np.ndarray:
    """Turn the upper half of the landmarks about their centre."""
    centre = shape.mean(axis=0)
    is_upper = shape[:, 1] < centre[1]
    return np.where(is_upper[:, None], (shape - centre) @ rotation(angle).T + centre, shape)


def mirrored(shapes: np.ndarray) -> np.ndarray:
    return shapes * [-1.0, 1.0] + [SIZE[0] - 1.0, 0.0]


def names_of(count: int) -> list[str]:
    return [f"image {i}" for i in range(count)]


@pytest.fixture(scope="module")
def samples():
    """Give textured objects and their landmarks; every other one is mirrored."""
    rng = np.random.default_rng(7)
    body = TexturedObject(rng, SIZE)
    made = []
    for i, shape in enumerate(shapes_of(rng, 24, spread=0.3)):
        image, shape = body.photograph(shape, rng)
        made.append((np.ascontiguousarray(image[:, ::-1]), mirrored(shape)) if i % 2 else (image, shape))
    return made


@pytest.fixture(scope="module")
def model(samples):
    return liaam.train(samples[:20], **QUICK)


def test_distances_ignore_the_pose_and_tell_mirrored_shapes(rng):
    one, other = shapes_of(rng, 2)
    moved = align(one, other)(one)
    apart = procrustes_distances(np.array([one, moved, other, mirrored(one)]))
    assert apart[0, 1] == pytest.approx(0.0, abs=1e-7)
    assert apart[0, 2] == pytest.approx(np.linalg.norm(moved - other) / np.linalg.norm(other - other.mean(0)), rel=1e-6)
    assert apart[0, 3] > 0.5 > apart[0, 2]


def test_shapes_of_one_kind_are_one_group(rng):
    shapes = shapes_of(rng, 40)
    assert [len(group) for group in shape_groups(shapes, names_of(40))] == [40]
    # Neither does one mode of large variance make two kinds, nor do a few mirrored images.
    bent = shapes + rng.normal(0.0, 8.0, (40, 1, 1)) * (np.arange(8) % 3 == 0)[:, None]
    assert len(shape_groups(bent, names_of(40))) == 1
    few = np.where(np.arange(40)[:, None, None] < 3, mirrored(shapes), shapes)
    assert len(shape_groups(few, names_of(40))) == 1
    assert len(shape_groups(np.array([*shapes[:6], *mirrored(shapes[6:12])]), names_of(12))) == 1
    # Nor does an object that bends: its shapes lie on a curve, without a gap.
    angles = rng.uniform(-1.2, 1.2, 60)
    bending = np.array(
        [bent_at_the_middle(shape, angle) for shape, angle in zip(shapes_of(rng, 60), angles, strict=True)]
    )
    assert len(shape_groups(bending, names_of(60))) == 1
    rigid = shapes_of(rng, 20, spread=0.0)
    assert len(shape_groups(rigid, names_of(20))) == 1
    copies = shapes[np.arange(40) % 5]
    assert len(shape_groups(copies, names_of(40))) == 1


@pytest.mark.parametrize("counts", [(20, 20), (24, 9), (16, 12, 10), (12, 11, 10, 9)])
def test_kinds_of_shape_are_told_apart(rng, counts):
    means = [BODY, mirrored(BODY), OTHER, mirrored(OTHER)]
    shapes = np.concatenate([shapes_of(rng, n, mean) for n, mean in zip(counts, means, strict=False)])
    kinds = np.repeat(np.arange(len(counts)), counts)
    order = rng.permutation(len(shapes))
    groups = shape_groups(shapes[order], names_of(len(shapes)))
    assert sorted(map(len, groups), reverse=True) == list(counts)
    assert all(len(set(kinds[order][group])) == 1 for group in groups)
    assert sorted(np.concatenate(groups)) == list(range(len(shapes)))


def test_kinds_of_shape_are_checked_apart(rng, capsys):
    shapes = shapes_of(rng, 40, spread=0.3)
    shapes[1::2] = mirrored(shapes[1::2])
    image = np.zeros((9, 9, 3), np.uint8)
    samples = [Sample(name, image, Landmarks(own)) for name, own in zip(names_of(40), shapes, strict=True)]
    assert faults_by_sample(samples, sides="one") == []
    assert "2 kinds of shape (20 images, 20 images), each checked by itself" in capsys.readouterr().out
    assert faults_by_sample(samples, 1, sides="one")


def test_a_person_is_not_a_kind_of_shape(rng):
    """Images of one person are alike, but a model of them says nothing about others."""
    means = [BODY + rng.normal(0.0, 4.0, BODY.shape) for _ in range(4)]
    shapes = np.concatenate([shapes_of(rng, 10, mean, 0.2) for mean in means])
    named = [f"{person}-{i}" for person in "abcd" for i in range(10)]
    assert len(shape_groups(shapes, named)) == 1
    assert len(shape_groups(shapes, names_of(40))) > 1


def test_the_number_of_kinds_may_be_given(rng):
    shapes = shapes_of(rng, 12)
    both = np.concatenate([shapes, mirrored(shapes[:4])])
    assert [len(group) for group in shape_groups(both, names_of(16), 1)] == [16]
    assert [group.tolist() for group in shape_groups(both, names_of(16), 2)] == [list(range(12)), [12, 13, 14, 15]]
    with pytest.raises(TrainingError, match="shapes 2: the images form groups of 12, 2, and a model needs 3"):
        shape_groups(both[:14], names_of(14), 2)


@pytest.mark.parametrize("wanted", [0, 5, 1.5, "two", None])
def test_bad_numbers_of_kinds_are_refused(samples, wanted):
    with pytest.raises(TrainingError, match=r"shapes .*: give 1 to 4, or 'auto'"):
        liaam.train(samples, shapes=wanted)


def test_each_kind_has_a_model(model, samples):
    assert [part.n_images for part in model.parts] == [10, 10]
    assert "2 shapes" in repr(model) and "20 images" in repr(model)
    parts = [model.part_of(truth) for _, truth in samples]
    assert parts[::2] == [parts[0]] * 12 and parts[1::2] == [1 - parts[0]] * 12
    with pytest.raises(TrainingError, match="their mean lies on one line"):
        liaam.train(samples[:20], shapes=1, lamps=None, sides="one")


@pytest.mark.parametrize("kind", ["none", "shape", "partial", "box", "candidate"])
def test_fits_find_the_kind(model, samples, kind):
    fitter = liaam.Fitter(model)
    for image, truth in samples[20:]:
        partial = np.where(np.arange(8)[:, None] < 5, truth + 1.0, np.nan)
        box = np.concatenate([truth.min(0), truth.max(0)])
        found = fitter.find(image)[0] if kind == "candidate" else None
        init = {"none": None, "shape": truth + 1.5, "partial": partial, "box": box, "candidate": found}[kind]
        result = fitter.fit(image, init)
        assert point_error(result.landmarks, truth) < 0.02 * diagonal_of(truth)
        part = fitter.part_for(result.landmarks)
        assert fitter.part_for(result) is part and part is fitter.parts[result.part]
        assert np.allclose(result.pose(part.shapes.shape(result.p)), result.landmarks, atol=0.1)


def test_a_model_of_several_shapes_is_saved_and_compacted(model, samples, tmp_path):
    model.save(tmp_path / "two.liaam")
    again = liaam.load_model(tmp_path / "two.liaam")
    expected = [liaam.fit(model, image).landmarks for image, _ in samples[20:]]
    for other in (again, liaam.compact(again)):
        assert [part.n_images for part in other.parts] == [10, 10]
        found = [result.landmarks for result in liaam.fit_many(other, [image for image, _ in samples[20:]])]
        assert np.array_equal(found, expected)
    fewer = liaam.train([(image, points[:7]) for image, points in samples[:20:2]], **QUICK)
    replace(model, others=(fewer,)).save(tmp_path / "wrong.liaam")
    with pytest.raises(ModelFileError, match="do not have the same number of landmarks"):
        liaam.load_model(tmp_path / "wrong.liaam")


def test_all_objects_of_both_kinds_are_found(model, samples):
    (left, first), (right, second) = samples[20], samples[21]
    both = np.concatenate([left, right], axis=1)
    found = Finder(model).find(both, limit=None, least=0.5)
    middles = sorted(candidate.landmarks.mean(axis=0)[0] for candidate in found[:2])
    assert np.allclose(middles, [first[:, 0].mean(), second[:, 0].mean() + SIZE[0]], atol=3.0)


def test_either_kind_is_tracked_and_relit(model, samples):
    fitter = liaam.Fitter(model)
    for image, truth in samples[20:22]:
        tracker = liaam.Tracker(model)
        frames = [np.roll(image, step, axis=1) for step in range(3)]
        tracked = [tracker.update(frame) for frame in frames]
        assert [frame.status for frame in tracked] == ["found", "tracked", "tracked"]
        assert point_error(tracked[2].landmarks, truth + np.array([2.0, 0.0])) < 0.02 * diagonal_of(truth)
        result = fitter.fit(image)
        relighter = Relighter.of(fitter, image, result)
        assert relighter.model is model.parts[model.part_of(truth)]
        assert np.abs(relighter.flat().astype(int) - image).mean() < 10.0
        residual, usable = residual_at(fitter, image, result)
        assert np.array_equal(residual, residual_at(fitter.part_for(truth), image, result)[0]) and usable.any()


def test_the_command_line_says_how_many_kinds_there_are(samples, tmp_path, run):
    folder = tmp_path / "both"
    folder.mkdir()
    for i, (image, points) in enumerate(samples[:18]):
        write_image(folder / f"{i:02d}.png", image)
        liaam.write_landmarks(folder / f"{i:02d}.pts", liaam.Landmarks(points))
    quick = "--no-leave-out", "--copies", "0", "--diagonal", "50", "--sides", "one"
    code, out, _ = run("train", folder, "-o", tmp_path / "m.liaam", *quick)
    assert code == 0 and "kinds of shape: 2, each with a model of its own: 9 images (50%), 9 images (50%)" in out
    code, out, _ = run("show", tmp_path / "m.liaam")
    assert code == 0 and "9 images (50%), 9 images (50%); below, the first" in out and "18 images" in out
