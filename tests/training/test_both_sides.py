"""One model of objects of two sides: training reflects one side, fits try both and say which, and files keep it."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import liaam
from liaam import Landmarks, Sample
from liaam.batch import Settings, run_batch
from liaam.cli.inputs import ALONE, ONE_SIDE, TURNED, other_ways
from liaam.error_measures import point_error
from liaam.errors import LiaamError, MethodError, ModelFileError, StartError, TrainingError
from liaam.evaluation import compare_specimens
from liaam.fitting import METHODS
from liaam.fitting.search.finder import Finder
from liaam.fitting.sides import as_fitted, reflected_result, reflected_start, reflections_of_start
from liaam.fitting.solution import residual_at
from liaam.io import write_image
from liaam.model import SURROUNDINGS
from liaam.model.shape import diagonal_of, in_box, rotation
from liaam.model.sides import Sides, reflected_image, reflected_points
from liaam.morphometry import of_one_side, read_specimens
from liaam.plotting.overlays import caption_of
from liaam.relighting import Relighter
from liaam.training.reliability import LeftOutImage, fits_near, least_shrunk_of_each, with_distant_and_wrong_fits
from setups import BODY, TexturedObject

SIZE = (110, 90)
WIDTH = SIZE[0]
QUICK = {"lamps": None, "copies": 0, "diagonal": 50, "leave_out": False}
N_TRAINED = 15


def mirrored(image, points):
    return reflected_image(image), reflected_points(points, WIDTH)


@pytest.fixture(scope="module")
def right():
    """Give textured objects of one side, and their landmarks."""
    rng = np.random.default_rng(7)
    body = TexturedObject(rng, SIZE)
    made = []
    for deviation in rng.normal(0.0, 0.3, (21, *BODY.shape)):
        shape = (BODY + deviation) @ rotation(rng.normal(0.0, 0.1)).T + rng.uniform(20, 24, 2)
        made.append(body.photograph(shape, rng))
    return made


@pytest.fixture(scope="module")
def both(right):
    """Give the same, of which every third is mirrored."""
    return [mirrored(*each) if i % 3 == 0 else each for i, each in enumerate(right)]


@pytest.fixture(scope="module")
def model(both):
    return liaam.train(both[:N_TRAINED], **QUICK)


def folder_of(path, pairs, names):
    """Write images and landmarks into a folder."""
    for name, (image, points) in zip(names, pairs, strict=True):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(path / f"{name}.png", image)
        liaam.write_landmarks(path / f"{name}.pts", Landmarks(points))
    return path


def test_a_model_of_both_sides_is_that_of_one(right, both, model):
    assert model.sides == Sides("original", 10, 5) and "sides original and mirrored" in repr(model)
    of_one = liaam.train(right[:N_TRAINED], **QUICK)
    assert of_one.sides is None
    np.testing.assert_allclose(model.shape_model.mean, of_one.shape_model.mean, atol=1e-9)
    means = [each.levels[-1].appearances["log"].mean for each in (model, of_one)]
    np.testing.assert_allclose(means[0], means[1], atol=1e-3)
    samples = [Sample(f"{i}", *each, side="rl"[i % 3 == 0]) for i, each in enumerate(both[:N_TRAINED])]
    stated = liaam.train([replace(each, side={"l": "left", "r": "right"}[each.side]) for each in samples], **QUICK)
    assert stated.sides == Sides("right", 10, 5)
    np.testing.assert_array_equal(stated.shape_model.mean, model.shape_model.mean)


def test_ways_to_fit_that_a_model_of_one_side_does_not_try_are_offered(right, model):
    of_one = liaam.train(right[:N_TRAINED], **QUICK)
    assert other_ways(of_one, "auto", None, ALONE) == f"{ONE_SIDE}; {TURNED}{ALONE}"
    assert other_ways(of_one, "both", None, "") == other_ways(model, "auto", None, "") == TURNED
    assert other_ways(model, "auto", "all", ALONE) == ""


def test_images_that_are_left_out_do_not_count_among_the_sides(both):
    samples = [Sample(f"{i}", *each, side="right" if i % 3 else "left") for i, each in enumerate(both[:N_TRAINED])]
    image, points = both[3]
    folded = points.copy()
    folded[[0, 1]] = points[[1, 0]]
    samples[3] = Sample("3", image, folded, side="left")
    with pytest.warns(UserWarning, match="fold the mesh"):
        model = liaam.train(samples, **QUICK)
    assert model.sides == Sides("right", 10, 4) and model.n_images == 14


def test_fits_of_the_wrong_side_are_among_the_wrong_fits_of_training(model, both):
    of_one = replace(model, sides=None)
    methods = [METHODS["soft-li"]]
    pictures = [LeftOutImage(of_one, *both[i]) for i in (16, 17, 19)]
    near = least_shrunk_of_each(fits_near(of_one, pictures, methods), refined=False)
    plain = with_distant_and_wrong_fits(of_one, pictures, methods, near)["soft-li"]
    with_sides = [replace(each, has_sides=True) for each in pictures]
    sided = with_distant_and_wrong_fits(of_one, with_sides, methods, near)["soft-li"]
    added = [fit for fit in sided.fits if not any(np.array_equal(fit.p, other.p) for other in plain.fits)]
    assert len(added) == 3 and all(fit.wrong and not fit.near for fit in added)


def test_sides_are_those_of_columns_folders_and_names(both, tmp_path):
    by_name = folder_of(tmp_path / "a", both[:6], [f"wing{i}_{'left' if i % 3 == 0 else 'right'}" for i in range(6)])
    assert [sample.side for sample in liaam.load_folder(by_name)] == ["left", "right", "right"] * 2
    by_folder = folder_of(tmp_path / "b", both[:6], [f"{'L' if i % 3 == 0 else 'R'}/wing{i}" for i in range(6)])
    assert (
        sorted(sample.side for sample in liaam.load_folder(by_folder, recursive=True)) == ["left"] * 2 + ["right"] * 4
    )
    some = folder_of(tmp_path / "c", both[:3], ["left_1", "2", "3"])
    assert [sample.side for sample in liaam.load_folder(some)] == [""] * 3
    table = tmp_path / "d"
    table.mkdir()
    rows = ["image,side,landmark,x,y"]
    for i, (image, points) in enumerate(both[:4]):
        write_image(table / f"{i}.png", image)
        rows += [f"{i}.png,{'links' if i % 3 == 0 else 'Rechts'},{k},{x},{y}" for k, (x, y) in enumerate(points, 1)]
    (table / "all.csv").write_text("\n".join(rows))
    assert [sample.side for sample in liaam.load_folder(table)] == ["left", "right", "right", "left"]
    (table / "all.csv").write_text("\n".join(rows).replace("landmark", "side,landmark").replace(".png,", ".png,L,"))
    with pytest.raises(liaam.errors.LandmarkError, match="there are 2 columns 'side': keep one"):
        liaam.load_folder(table)


def test_sides_that_cannot_be_are_refused_in_training(both):
    samples = [Sample(f"w{i}", *each, side=("left", "right", "right")[i % 3]) for i, each in enumerate(both[:9])]
    with pytest.raises(TrainingError, match=r"neither left nor right: w1 \('up'\)"):
        liaam.train([samples[0], replace(samples[1], side="up"), *samples[2:]], **QUICK)
    with pytest.raises(TrainingError, match="4 of 9 images have no side, and others have: w0, w1, w2, w3; complete"):
        liaam.train([replace(each, side="") for each in samples[:4]] + samples[4:], **QUICK)
    with pytest.warns(UserWarning, match=r"1 image is taken .*: w1 \(stated left, right by the shape\)"):
        model = liaam.train([samples[0], replace(samples[1], side="left"), *samples[2:]], **QUICK)
    assert model.sides == Sides("right", 6, 3)
    with pytest.raises(TrainingError, match="sides 'up': give auto, both, one"):
        liaam.train(both, sides="up")


@pytest.mark.parametrize("kind", ["none", "shape", "partial", "box", "place", "detection", "landmarks", "mean"])
def test_fits_find_the_side(model, both, kind):
    fitter = liaam.Fitter(model)
    for i, (image, truth) in enumerate(both[N_TRAINED:], N_TRAINED):
        box = np.concatenate([truth.min(0), truth.max(0)])
        place = (*truth.mean(0), diagonal_of(truth))
        partial = np.where(np.arange(8)[:, None] < 5, truth + 1.0, np.nan)
        starts = {"none": None, "shape": truth + 1.5, "partial": partial, "box": box, "place": place}
        starts["mean"] = in_box(model.shape_model.mean, 0.5 * (truth.min(0) + truth.max(0)), diagonal_of(truth))
        starts |= {"detection": fitter.find(image)[0], "landmarks": Landmarks(truth + 1)}
        result = fitter.fit(image, starts[kind])
        assert result.reflected == (i % 3 == 0)
        assert result.side == ("mirrored" if i % 3 == 0 else "original")
        assert point_error(result.landmarks, truth) < 0.02 * diagonal_of(truth)
        assert np.allclose(result.pose(fitter.shapes.shape(result.p)), result.landmarks, atol=0.1)
        if kind not in ("shape", "partial", "landmarks"):
            other = fitter.fit(reflected_image(image), None)
            assert other.side != result.side
        if kind == "none":
            assert point_error(reflected_points(other.landmarks, WIDTH), result.landmarks) < 1e-6
            flipped = reflected_result(result, WIDTH)
            np.testing.assert_allclose(flipped.landmark_covariances, other.landmark_covariances)
            assert flipped.found is not None and other.found is not None
            assert flipped.found.reflected == other.found.reflected
            np.testing.assert_allclose(flipped.found.landmarks, other.found.landmarks)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ([1.0, 2.0], "neither landmarks"),
        ("box", "is not a shape"),
        ([[1.0, 2.0], [3.0]], "is not a shape"),
        (np.zeros((5, 2)), "the start has 5 landmarks but the model has 8"),
        (np.full((8, 2), 20.0), "only 0.0 pixels large"),
        (np.full((8, 2), np.nan), "only 0 of the start's landmarks are finite"),
        ((50, 20, 10, 40), "is empty"),
    ],
)
def test_bad_starts_are_refused_as_by_models_of_one_side(model, both, start, words):
    with pytest.raises(StartError, match=words):
        liaam.fit(model, both[18][0], start)


def test_a_reflection_of_a_result_is_undone_by_another(model, both):
    image, _ = both[18]
    result = liaam.fit(model, image)
    assert result.reflected
    pixels, fitted = as_fitted(image, result)
    np.testing.assert_array_equal(pixels, reflected_image(image))
    again = reflected_result(fitted, WIDTH)
    np.testing.assert_allclose(again.landmarks, result.landmarks, atol=1e-9)
    np.testing.assert_allclose(again.start, result.start, atol=1e-9)
    np.testing.assert_allclose(again.pose.matrix, result.pose.matrix)
    assert again.reflected and not fitted.reflected
    assert fitted.found is not None and result.found is not None and fitted.found.rotation == -result.found.rotation


def test_a_stated_side_that_the_shape_contradicts_is_a_fault(run, both, tmp_path):
    names = [f"w{i}_{'left' if i % 3 == 0 else 'right'}" for i in range(9)]
    code, out, _ = run("check", folder_of(tmp_path / "right", both[:9], names))
    assert code == 0 and "no faults found" in out
    code, out, err = run("check", folder_of(tmp_path / "wrong", both[:9], ["w0_left", "w1_left", *names[2:]]))
    assert code == 1 and "no other faults found" in out
    assert "1 image is taken to be of the other side than stated: w1_left (stated left, right by the shape)" in err
    assert "correct the sides that are stated: the column 'side', the folders or the names" in err


def test_the_mean_shape_with_names_in_another_order_says_no_side(model):
    names = tuple(f"n{i}" for i in range(model.n_points))
    named = replace(model, landmark_names=names)
    mean = model.shape_model.mean
    given = Landmarks(mean[::-1], names=names[::-1])
    assert reflections_of_start(named, given, 200) == reflections_of_start(named, mean, 200) == (False, True)
    np.testing.assert_allclose(reflected_start(named, given, 200), reflected_start(named, mean, 200))


def test_the_side_may_be_given(model, both, right):
    image, truth = both[18]
    wrong = liaam.fit(model, image, side="original")
    assert wrong.side == "original" and not wrong.reflected
    assert liaam.fit(model, image, side="mirrored").reflected
    with pytest.raises(MethodError, match=r"'left'; choose from auto, both, original, mirrored \(nothing told"):
        liaam.Fitter(model, side="left")
    of_one = liaam.train(right[:N_TRAINED], **QUICK)
    assert liaam.fit(of_one, image).side == ""
    found = liaam.fit(of_one, image, side="both")
    assert found.side == "mirrored" and point_error(found.landmarks, truth) < 0.02 * diagonal_of(truth)
    assert liaam.train(right[:N_TRAINED], sides="both", **QUICK).sides == Sides("original", 15, 0)
    assert liaam.train(right[:N_TRAINED], **QUICK).sides is None


def test_objects_of_both_sides_in_an_image_are_all_found(model, both):
    (left, first), (other, second) = both[18], both[19]
    image = np.concatenate([left, other], axis=1)
    fits = liaam.fit_all(model, image)
    for side, truth in (("mirrored", first), ("original", second + np.array([WIDTH, 0.0]))):
        on_it = [fit for fit in fits if np.linalg.norm(fit.landmarks.mean(0) - truth.mean(0)) < 5]
        assert [fit.side for fit in on_it] == [side]
        assert point_error(on_it[0].landmarks, truth) < 0.02 * diagonal_of(truth)


def test_a_place_of_the_other_side_counts_only_if_its_fit_is_right(model, both, monkeypatch):
    (left, first), (other, second) = both[18], both[19]

    def n_found_in(beside):
        """Fit an image where the search for each side is certain of a place: of the object, and of what is beside."""
        image = np.concatenate([left, beside], axis=1)
        place = replace(liaam.fit(model, image).found, score=0.9, others=(), reflected=False)
        there = replace(place, landmarks=second + np.array([WIDTH, 0.0]))
        here = replace(place, landmarks=reflected_points(first, 2 * WIDTH))
        answers = iter([there, here])
        with monkeypatch.context() as patch:
            patch.setattr(Finder, "first_in", lambda *_: next(answers))
            return liaam.fit(model, image).n_found

    assert n_found_in(other) == 2
    assert n_found_in(np.full_like(other, 90)) == 1  # as on a ruler


def test_a_mirrored_object_is_compared_and_relit(model, both):
    image, _ = both[18]
    fitter = liaam.Fitter(model)
    result = fitter.fit(image)
    residual, usable = residual_at(fitter, image, result)
    other = residual_at(fitter, reflected_image(image), fitter.fit(reflected_image(image)))
    np.testing.assert_allclose(residual, other[0], atol=1e-4)
    assert usable.any()
    relighter = Relighter.of(fitter, image, result)
    assert relighter.inside.any()
    assert np.abs(relighter.flat().astype(int) - image).mean() < 10.0
    as_trained = Relighter.of(fitter, reflected_image(image), fitter.fit(reflected_image(image)))
    for one, mirror_image in ((relighter, as_trained), (as_trained, relighter)):
        lit = one.under((0.8, 0.0, 0.6)).astype(int)
        expected = reflected_image(mirror_image.under((-0.8, 0.0, 0.6))).astype(int)
        assert np.abs(lit - expected).mean() < 1.0 < np.abs(lit - one.picture).mean()
    with pytest.raises(LiaamError, match="of different sides"):
        relighter.like(as_trained)


def test_a_mirrored_object_is_tracked(model, both):
    """Also by a model of few modes, whose shapes do not hold their own mirror images."""
    image, truth = both[18]
    shapes = model.views[SURROUNDINGS].warp.shape_model
    few = replace(shapes, modes=shapes.modes[:2], eigenvalues=shapes.eigenvalues[:2])
    warp = replace(model.views[SURROUNDINGS].warp, shape_model=few)
    tracker = liaam.Tracker(model.with_view(SURROUNDINGS, warp=warp))
    tracked = [tracker.update(np.roll(image, step, axis=1)) for step in range(3)]
    assert [frame.status for frame in tracked] == ["found", "tracked", "tracked"]
    assert all(frame.status == "found" or tracker.state.reflected for frame in tracked)
    assert point_error(tracked[2].landmarks, truth + np.array([2.0, 0.0])) < 0.03 * diagonal_of(truth)


def test_files_keep_the_sides(model, both, tmp_path):
    model.save(tmp_path / "m.liaam")
    again = liaam.load_model(tmp_path / "m.liaam")
    assert again.sides == model.sides
    assert liaam.compact(again).sides == model.sides
    image, _ = both[18]
    np.testing.assert_array_equal(liaam.fit(again, image).landmarks, liaam.fit(model, image).landmarks)
    content = (tmp_path / "m.liaam").read_bytes()
    stored = b'\\"own\\": \\"original\\"'
    assert stored in content
    (tmp_path / "bad.liaam").write_bytes(content.replace(stored, stored.replace(b"original", b"sideways")))
    with pytest.raises(ModelFileError, match="side 'sideways' is none of left"):
        liaam.load_model(tmp_path / "bad.liaam")


def test_results_and_tables_say_the_side(model, both, tmp_path):
    model.save(tmp_path / "m.liaam")
    folder = tmp_path / "images"
    folder.mkdir()
    for i, (image, _) in enumerate(both[N_TRAINED:]):
        write_image(folder / f"{i}.png", image)
    result = liaam.fit(model, both[18][0])
    assert result.to_dict()["side"] == "mirrored" and ", mirrored" in repr(result) and "mirrored" in caption_of(result)
    run_batch(tmp_path / "m.liaam", folder, tmp_path / "t.csv", Settings(iterations=20))
    with (tmp_path / "t.csv").open(newline="") as file:
        assert [row["side"] for row in csv.DictReader(file)] == ["mirrored", "original", "original"] * 2
    specimens, said = of_one_side(read_specimens(tmp_path / "t.csv"))
    assert [each.reflected for each in specimens] == [True, False, False] * 2
    assert said == "2 mirrored specimens were reflected, to be compared with the original ones"
    truths = [truth for _, truth in both[N_TRAINED:]]
    unreflected = read_specimens(tmp_path / "t.csv")
    labels = [replace(each, points=truth, status="") for each, truth in zip(unreflected, truths, strict=True)]
    assert compare_specimens(specimens, [labels]).n_specimens == 6
    assert np.abs(compare_specimens(specimens, [labels]).bias).max() < 0.02


def test_a_batch_of_landmarks_alone_says_that_sides_are_lost_and_measuring_finds_them(model, both, tmp_path, run):
    folder = folder_of(tmp_path / "new", both[N_TRAINED:], [f"w{i}" for i in range(6)])
    model.save(tmp_path / "m.liaam")
    for _ in range(2):  # also if there is nothing to do
        code, out, err = run("batch", tmp_path / "m.liaam", folder, "-o", tmp_path / "out.tps")
        assert code == 0 and "2 mirrored and 4 original ones are as they lie in the images" in " ".join(err.split())
        told = " ".join((out + err).split())
        assert "6 fits: 6 converged" in told and "landmarks of the 6 fits that may be used" in told
        assert "column 'm" not in told and "row" not in told
    _, _, err = run("batch", tmp_path / "m.liaam", folder, "-o", tmp_path / "out.csv")
    assert "as they lie" not in " ".join(err.split())
    code, out, _ = run("measure", tmp_path / "out.tps", "-o", tmp_path / "t.csv")
    said = "2 of 6 specimens are mirrored by their shapes, and were reflected, to be compared with the others: w0, w3"
    assert code == 0 and said in " ".join(out.split())


def test_the_command_line_says_how_many_are_of_each_side(both, tmp_path, run):
    names = [f"w{i}{'L' if i % 3 == 0 else 'R'}" for i in range(N_TRAINED)]
    folder = folder_of(tmp_path / "w", both[:N_TRAINED], names)
    quick = "--no-leave-out", "--copies", "0", "--diagonal", "50"
    code, out, err = run("train", folder, "-o", tmp_path / "m.liaam", *quick)
    said = "10 right and 5 left training images; the left ones are reflected; fits try both sides"
    assert (code, err) == (0, "") and said in " ".join(out.split())
    code, out, _ = run("show", tmp_path / "m.liaam", "-o", tmp_path / "m.json")
    assert code == 0 and said in " ".join(out.split())
    facts = json.loads((tmp_path / "m.json").read_text())
    assert facts["sides"] == {"own": "right", "n_own": 10, "n_other": 5, "other": "left"}
    image = folder_of(tmp_path / "new", both[18:19], ["x"]) / "x.png"
    _, out, _ = run("fit", tmp_path / "m.liaam", image, "-o", tmp_path / "fits")
    assert "left" in out and json.loads((tmp_path / "fits" / "x.json").read_text())["side"] == "left"
    code, _, err = run("fit", tmp_path / "m.liaam", image, "-o", tmp_path / "fits", "--side", "up")
    assert code == 1 and "unknown side 'up'; choose from auto, both, right, left" in err
    code, out, _ = run("check", folder)
    assert code == 0 and "side left: 5 of 15 images, whose landmarks are compared reflected" in " ".join(out.split())
    code, out, _ = run("evaluate", tmp_path / "m.liaam", tmp_path / "new", "-o", tmp_path / "errors")
    assert code == 0 and "sides: 1 left; fits of the wrong side: 0" in " ".join(out.split())


def test_a_few_mirrored_images_are_named_by_the_check(both, right, tmp_path, run):
    pairs = [mirrored(*each) if i == 4 else each for i, each in enumerate(right[:12])]
    folder = folder_of(tmp_path / "w", pairs, [f"{i}" for i in range(12)])
    code, out, _ = run("check", folder)
    assert code == 1 and "mirrored, as an object of the other side, whose image training reflects" in " ".join(
        out.split()
    )
    code, out, err = run("train", folder, "-o", tmp_path / "m.liaam", "--no-leave-out", "--copies", "0")
    said = "11 original and 1 mirrored training images; the mirrored ones are reflected"
    assert (code, err) == (0, "") and said in " ".join(out.split())


def test_points_of_another_landmarker_are_reflected_with_their_image(both):
    points = [points[:5] + 0.5 for _, points in both[:N_TRAINED]]
    model = liaam.train(both[:N_TRAINED], points=points, **QUICK)
    assert model.points is not None and model.points.deviation < 1.0
    image, truth = both[18]
    result = liaam.fit(model, image, truth[:5] + 0.5)
    assert result.reflected and point_error(result.landmarks, truth) < 0.03 * diagonal_of(truth)
