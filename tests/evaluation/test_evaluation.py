"""Evaluations of models on landmarked images."""

import csv
import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import liaam
from liaam import Evaluation, FitStatus, Landmarks, Sample
from liaam.cli.evaluate import show_landmarks
from liaam.error_measures import landmark_errors, within_ellipses
from liaam.errors import LiaamError
from liaam.evaluation import measure
from liaam.io import read_image, read_landmarks, write_image, write_landmarks
from liaam.io.files import fingerprint_of, real_path
from liaam.studio.folder import Folder
from liaam.studio.store import Store

SQUARE = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0], [0.0, 40.0]])  # the diagonal is 50
OPTIONS = {"diagonal": 40.0, "leave_out": False, "copies": 0, "methods": "grey"}


def evaluation(shifts, statuses, limit=0.03) -> Evaluation:
    """Fits that are all off by some pixels to the right."""
    k = len(shifts)
    moved = SQUARE + np.array(shifts)[:, None, None] * [1, 0]
    arrays = np.repeat(SQUARE[None], k, axis=0), moved, np.tile(np.eye(2), (k, 4, 1, 1)), np.full(k, 0.5)
    images = (np.zeros((50, 50, 3), np.uint8),) * k
    names = tuple(f"im{i}" for i in range(k))
    return Evaluation(names, images, *arrays, statuses, np.full(k, 50.0), "the diagonal", limit, tuple("abcd"))


OK, DOUBTFUL, DIVERGED = FitStatus.CONVERGED, FitStatus.DOUBTFUL, FitStatus.DIVERGED


@pytest.fixture
def mixed() -> Evaluation:
    return evaluation([1.0, 1.5, 1.6, 5.0, np.nan], (OK, DOUBTFUL, OK, DOUBTFUL, DIVERGED))


def test_fits_are_right_refused_silent_or_lost(mixed):
    assert mixed.outcomes == ["right", "refused", "silent", "lost", "lost"]
    np.testing.assert_allclose(mixed.errors, [0.02, 0.03, 0.032, 0.1, np.inf])
    report = mixed.report()
    assert "median 3.20, 90th percentile inf, largest inf" in report
    assert "wrong (error above 3.0%): 3 of 5, 1 of them silent (the status says that they may be used)" in report
    assert "refused (error within this limit, but the status is doubtful or failed): 1" in report
    assert mixed.worst(2).tolist() == [4, 3]
    assert mixed.coverage == 1.0  # of im0 and im2
    assert evaluation([2.4, 2.5], (OK, OK)).coverage == 0.5  # the radius is 2.45 standard deviations
    assert np.isnan(evaluation([1.0], (DOUBTFUL,)).coverage)


def test_the_printed_table_says_how_many_landmarks_it_leaves_out(mixed, capsys):
    arrays = {name: np.tile(getattr(mixed, name), (1, 3, 1)) for name in ("truths", "landmarks")}
    covariances = np.tile(mixed.covariances, (1, 3, 1, 1))
    show_landmarks(replace(mixed, **arrays, covariances=covariances, landmark_names=()))
    assert "these are the 10 landmarks of 12 with the largest errors" in " ".join(capsys.readouterr().out.split())
    show_landmarks(mixed)
    assert "largest errors" not in capsys.readouterr().out


def test_tables_count_landmarks_from_1_and_name_them(mixed):
    table = mixed.to_dataframe()
    assert len(table) == 20
    assert table.iloc[5][["image", "landmark", "name", "error", "error_percent"]].tolist() == ["im1", 2, "b", 1.5, 3.0]
    assert table.error.iloc[-1] == np.inf and table.true_x.iloc[-2] == 30.0
    assert mixed.by_image()["outcome"] == mixed.outcomes
    columns = mixed.by_landmark()
    assert (columns["landmark"], columns["name"]) == ([1, 2, 3, 4], list("abcd"))
    assert columns["median"] == pytest.approx([1.6] * 4)
    assert (columns["p90"], columns["inside_percent"]) == ([np.inf] * 4, [100.0] * 4)


def test_the_curve_and_the_worst_fits_are_drawn(mixed):
    line = mixed.plot().lines[0]
    at = dict(zip(np.round(line.get_xdata(), 3), line.get_ydata(), strict=True))
    assert (at[1.995], at[3.0], at[6.0]) == pytest.approx((0.0, 40.0, 60.0))
    figure = mixed.plot_worst(2)
    assert [axis.get_title() for axis in figure.axes] == ["im4\ninf%, diverged", "im3\n10.0%, doubtful"]


def test_ellipses_hold_the_truth_or_not_or_that_is_unknown():
    truth = np.array([[0.0, 0.0], [np.nan, np.nan], [0.0, 0.0], [0.0, 0.0], [1e200, 0.0]])
    shape = np.array([[2.0, 0.0], [0.0, 0.0], [np.inf, 0.0], [0.0, 0.0], [0.0, 0.0]])
    spread = np.array([np.diag([1.0, 1e-300]), np.eye(2), np.eye(2), np.full((2, 2), np.nan), np.eye(2)])
    found = within_ellipses(shape, truth, spread)
    np.testing.assert_array_equal(found, [1, np.nan, 0, np.nan, 0])
    assert within_ellipses(shape[:1], truth[:1], np.zeros((1, 2, 2)))[0] == 0
    np.testing.assert_array_equal(landmark_errors(shape, truth), [2, np.nan, np.inf, 0, 1e200])


@pytest.fixture(scope="module")
def scenes():
    """Six kites of different proportions, in four colours."""
    return [kite(np.random.default_rng(i)) for i in range(6)]


def kite(rng) -> SimpleNamespace:
    corners = np.array([[48, 8], [84, 30], [50, 84], [12, 30], [48, 32]]) + rng.normal(0, 1.5, (5, 2))
    image = np.full((96, 96, 3), 200, np.uint8)
    for i, colour in enumerate([(150, 60, 50), (60, 120, 70), (70, 80, 150), (160, 140, 40)]):
        triangle = np.rint(16 * corners[[i, (i + 1) % 4, 4]]).astype(np.int32)
        cv2.fillPoly(image, [triangle], colour, cv2.LINE_AA, 4)
    noisy = image + rng.normal(0, 2, image.shape)
    return SimpleNamespace(image=np.clip(noisy, 0, 255).astype(np.uint8), landmarks=corners)


@pytest.fixture(scope="module")
def small(scenes):
    return liaam.train([(scene.image, scene.landmarks) for scene in scenes[:4]], **OPTIONS)


def as_samples(scenes, **more):
    return [Sample(f"im{i}", scene.image, Landmarks(scene.landmarks, **more)) for i, scene in enumerate(scenes)]


def test_models_are_evaluated_on_samples_and_pairs(small, scenes):
    tested, starts = scenes[4:], [scene.landmarks for scene in scenes[4:]]
    found = liaam.evaluate(small, as_samples(tested), starts, "grey", normalise="1-3")
    results = liaam.fit_many(small, [scene.image for scene in tested], starts, "grey")
    np.testing.assert_array_equal(found.landmarks, [result.landmarks for result in results])
    size = np.linalg.norm(tested[0].landmarks[0] - tested[0].landmarks[2])
    error = np.linalg.norm(results[0].landmarks - tested[0].landmarks, axis=1).mean()
    assert found.errors[0] == pytest.approx(error / size)
    assert (found.limit, found.normaliser) == (0.08, "the distance between landmarks 1-3")
    pairs = liaam.evaluate(small, [(s.image, s.landmarks) for s in tested], starts, "grey")
    assert (pairs.names, pairs.limit) == (("image 1", "image 2"), 0.03)
    np.testing.assert_array_equal(pairs.distances, found.distances)


def test_names_decide_and_images_that_do_not_suit_are_left_out(small, scenes):
    names = tuple(f"p{i}" for i in range(5))
    named, (first, second) = replace(small, landmark_names=names), as_samples(scenes[4:], names=names)
    turned = replace(first, landmarks=Landmarks(first.landmarks.points[::-1], names=names[::-1]))
    few = Sample("few", first.image, Landmarks(SQUARE))
    other = replace(second, landmarks=Landmarks(second.landmarks.points, names=("q", *names[1:])))
    gone = replace(second, name="gone", landmarks=Landmarks(np.full((5, 2), np.nan)))
    found = liaam.evaluate(named, [turned, few, other, gone], first.landmarks.points, "grey")
    np.testing.assert_array_equal(found.truths, [first.landmarks.points])
    assert found.names == ("im0",)
    for words, line in zip(("has 4 landmarks", "no landmark p0", "0 or unknown"), found.left_out, strict=True):
        assert words in line
    with pytest.raises(LiaamError, match="no images to evaluate: few: it has 4 landmarks, where 5 are fitted"):
        liaam.evaluate(small, [few])
    for wrong, words in (
        ("1", "give two landmarks, such as 3-7"),
        ("1-99", "no landmark '99'; give numbers from 1 to 5"),
    ):
        with pytest.raises(LiaamError, match=words):
            liaam.evaluate(small, [first], normalise=wrong)
    with pytest.raises(LiaamError, match="limit 0: give a positive fraction"):
        liaam.evaluate(small, [first], limit=0.0)


def test_each_image_keeps_its_start_where_others_are_left_out(small, scenes):
    first, second = as_samples(scenes[4:])
    few = Sample("few", SQUARE, Landmarks(SQUARE))
    starts = [first.landmarks.points, SQUARE, second.landmarks.points]
    found = liaam.evaluate(small, [first, few, second], starts, "grey")
    whole = liaam.evaluate(small, [first, second], starts[::2], "grey")
    np.testing.assert_array_equal(found.landmarks, whole.landmarks)
    with pytest.raises(LiaamError, match="3 images but 2 starts"):
        liaam.evaluate(small, [first, few, second], starts[:2], "grey")
    with pytest.raises(LiaamError, match="3 images but 2 starts"):
        liaam.evaluate(small, [first, few, second], iter(starts[:2]), "grey")


def test_of_several_objects_the_nearest_counts(small, scenes):
    image, points = scenes[4].image, scenes[4].landmarks
    two = [Sample("a", image, Landmarks(points + 60)), Sample("a#2", image, Landmarks(points))]
    found = liaam.evaluate(small, two, points, "grey")
    assert found.names == ("a",)
    np.testing.assert_array_equal(found.truths[0], points)


def test_no_image_is_evaluated_by_a_model_that_has_seen_it(scenes, monkeypatch):
    seen = []
    trained = liaam.train
    monkeypatch.setattr(measure, "train", lambda data, **o: seen.append([s.name for s in data]) or trained(data, **o))
    samples = as_samples(scenes)
    found = liaam.cross_validate(samples, 2, "grey", training=OPTIONS, limit=0.5)
    assert found.names == tuple(sample.name for sample in samples)
    assert seen == [["im3", "im4", "im5"], ["im0", "im1", "im2"]]
    with pytest.raises(LiaamError, match="folds 1: give 2 or more"):
        liaam.cross_validate(samples, 1)
    with pytest.raises(LiaamError, match="no images to evaluate; give landmarked images"):
        liaam.cross_validate([])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scenes, small):
    folder = tmp_path_factory.mktemp("evaluate")
    small.save(folder / "face.liaam")
    (folder / "faces").mkdir()
    for i, scene in enumerate(scenes[2:]):
        write_image(folder / "faces" / f"f{i}.png", scene.image)
        write_landmarks(folder / "faces" / f"f{i}.pts", scene.landmarks)
    return folder


def test_the_command_writes_tables_and_pictures(run, folder, tmp_path):
    options = ("-m", "grey", "--init", folder / "faces", "--limit", 20, "-o", tmp_path / "out")
    code, out, _ = run("evaluate", folder / "face.liaam", folder / "faces", *options)
    assert code == 0
    assert "4 images; mean error in % of the diagonal of the landmarks' box" in out
    assert "wrong (error above 20.0%): 0 of 4" in out
    tables = {name: (tmp_path / f"out/{name}.csv").open() for name in ("errors", "images", "landmarks")}
    rows = {name: list(csv.DictReader(table)) for name, table in tables.items()}
    assert [len(own) for own in rows.values()] == [4 * 5, 4, 5]
    assert {row["outcome"] for row in rows["images"]} == {"right"}
    assert all((tmp_path / "out" / name).read_bytes()[:4] == b"\x89PNG" for name in ("errors.png", "worst.png"))


def test_images_of_training_are_known_by_their_content_and_reported(run, folder, small, tmp_path):
    files = sorted((folder / "faces").glob("*.png"))
    prints = tuple(sorted(fingerprint_of(file) for file in files[:2]))
    seen = replace(small, fingerprints=prints)
    seen.save(tmp_path / "seen.liaam")
    assert liaam.load_model(tmp_path / "seen.liaam").fingerprints == prints
    data = [(file, file.with_suffix(".pts")) for file in files]
    found = liaam.evaluate(liaam.load_model(tmp_path / "seen.liaam"), data, method="grey", progress=False)
    assert found.in_training == (True, True, *[False] * (len(files) - 2))
    assert f"the model was trained on 2 of these {len(files)} images (f0, f1)" in found.report()
    assert found.by_image()["in_training"][:3] == [True, True, False]
    options = ("-m", "grey", "--init", folder / "faces", "--limit", 20, "-o", tmp_path / "out")
    _, out, err = run("evaluate", tmp_path / "seen.liaam", folder / "faces", *options)
    told = " ".join((out + err).split())
    assert "the model was trained on 2 of these" in told and "for the section Methods of a paper:" not in told
    other = liaam.evaluate(replace(seen, fingerprints=("abcdefghijklmnop",)), data[:2], method="grey", progress=False)
    assert other.in_training == (False, False) and "trained on" not in other.report()
    unknown = liaam.evaluate(replace(small, fingerprints=()), data[:2], method="grey", progress=False)
    assert "does not say which images it was trained on" in unknown.report()


def test_training_keeps_the_fingerprints_of_files(folder):
    files = sorted((folder / "faces").glob("*.png"))
    pairs = [(file, file.with_suffix(".pts")) for file in files]
    quick = OPTIONS | {"lamps": None}
    assert liaam.train(pairs, **quick).fingerprints == tuple(sorted(map(fingerprint_of, files)))
    assert liaam.train([(read_image(file), marks) for file, marks in pairs], **quick).fingerprints == ()


def test_the_command_trains_on_folds(run, folder, tmp_path, monkeypatch):
    changed = OPTIONS | {"progress": False}
    monkeypatch.setattr(measure, "train", lambda data, **options: liaam.train(data, **options | changed))
    run_folds = partial(run, "evaluate", "--folds", 4, "-m", "grey", "--limit", 50, "-o", tmp_path / "e.csv")
    code, out, _ = run_folds(folder / "faces")
    assert code == 0 and "wrong (error above 50.0%): 0 of 4" in out
    assert len((tmp_path / "e.csv").read_text().splitlines()) == 1 + 4 * 5
    for more, words in (
        ((folder / "face.liaam", folder / "faces"), "give the folder only, or leave --folds out"),
        ((folder / "faces", "--init", "1,2,3"), "leave --init or --folds out"),
        ((folder / "faces", "-o", folder / "faces" / "e.csv"), "is inside the folder of landmarks"),
    ):
        code, _, err = run_folds(*more)
        assert code == 1 and words in err
    code, _, err = run("evaluate", tmp_path / "none.liaam", folder / "faces", "-o", tmp_path / "none")
    assert code == 1 and not (tmp_path / "none").exists()
    code, _, err = run("evaluate", folder / "faces")
    assert code == 1 and "give a model and a folder of landmarked images, or one folder and --folds 5" in err


def test_errors_along_contours_are_told_from_errors_across():
    found = replace(evaluation([1.0, 4.0], (OK, OK)), contours=(((0, 1, 2), False),))
    assert found.outcomes == ["right", "silent"]
    np.testing.assert_allclose(found.outline_errors, [0.015, 0.06])  # three of four are across
    table = found.by_landmark()
    assert table["along_percent"][0] == pytest.approx(5.0) and table["across_percent"][0] == 0.0
    assert np.isnan(table["along_percent"][3]) and table["inside_across_percent"][0] == 100.0
    assert found.by_image()["outline_outcome"] == found.outline_outcomes
    assert found.to_columns()["along"][:2] == pytest.approx([1.0, 1.0 * 30 / 50])
    assert "by outline" in found.report() and "along" in found.report()
    assert "by outline" not in evaluation([1.0], (OK,)).report()
    line = np.column_stack([[0.0, 10.0, 20.0, 30.0], np.zeros(4)])[None]
    slid = replace(
        evaluation([0.0], (OK,)), truths=line, landmarks=np.add(line, [4.0, 0.0]), contours=((range(4), False),)
    )
    assert slid.outcomes == ["silent"]
    assert slid.outline_outcomes == ["right"]  # only the last is off, beyond the end


def write_labels(folder, scenes, rng, sd):
    folder.mkdir()
    for i, scene in enumerate(scenes):
        write_landmarks(folder / f"f{i}.pts", scene.landmarks + rng.normal(0, sd, scene.landmarks.shape))


def test_the_command_compares_shapes_with_those_of_two_people_and_of_groups(run, folder, scenes, tmp_path, rng):
    faces = tmp_path / "faces"
    write_labels(faces, scenes, rng, 1.0)
    write_labels(tmp_path / "second", scenes, rng, 1.0)
    for i, scene in enumerate(scenes):
        write_image(faces / f"f{i}.png", scene.image)
    groups = tmp_path / "groups.csv"
    groups.write_text("specimen,group\n" + "".join(f"f{i}.png,{'ab'[i % 2]}\n" for i in range(6)), encoding="utf-8")
    options = ("-m", "grey", "--init", faces, "--limit", 50, "-o", tmp_path / "out", "--groups", groups)
    code, out, err = run("evaluate", folder / "face.liaam", faces, *options, "--second", tmp_path / "second")
    assert code == 0, err
    assert "of the shapes of two people" in out
    assert "for the section Methods of a paper: Automatic landmarks of 6 specimens" in out
    read = json.loads((tmp_path / "out/shapes.json").read_text())
    assert read["n_specimens"] == 6 and read["attenuation"] is not None and read["repeatability_of_people"] < 1
    assert (tmp_path / "out/shapes.png").read_bytes()[:4] == b"\x89PNG"
    code, _, err = run("evaluate", folder / "face.liaam", faces, *options, "--second", faces)
    assert code == 1 and "is the folder of the first person's landmarks" in err


def test_points_that_the_studio_proposed_are_no_labels(run, folder, scenes, tmp_path, rng):
    faces = tmp_path / "faces"
    write_labels(faces, scenes, rng, 1.0)
    for i, scene in enumerate(scenes):
        write_image(faces / f"f{i}.png", scene.image)
    points = read_landmarks(faces / "f1.pts").points.tolist()
    store = Store(Folder(real_path(faces)))
    store.put("origin", {"f1.png": {"accepted": points[:2], "confirmed": points[2:3]}})
    store.close()
    options = ("-m", "grey", "--init", faces, "--limit", 50, "-o", tmp_path / "out")
    code, out, err = run("evaluate", folder / "face.liaam", faces, *options)
    assert code == 0
    assert "2 points of 1 image left out, because they were accepted as the studio proposed them: f1" in err
    assert "shapes of 5 specimens (1 left out, which lack landmarks)" in out
    rows = [row for row in csv.DictReader((tmp_path / "out/errors.csv").open()) if row["image"] == "f1"]
    assert [row["true_x"] == "" for row in rows] == [True, True, False, False, False]


@pytest.mark.parametrize("given", [("--groups", "groups.csv"), ("--folds", "3"), ("--init", "1,2,3")])
def test_options_that_a_learning_curve_does_not_use_are_refused(run, tmp_path, given):
    code, _, err = run("evaluate", tmp_path, "--learning-curve", *given)
    assert code == 1 and f"compares no groups; leave {given[0]} out" in err


def test_a_learning_curve_takes_no_model(run, tmp_path):
    code, _, err = run("evaluate", tmp_path / "model.liaam", tmp_path, "--learning-curve")
    assert code == 1 and "--learning-curve trains models on the folder itself: give the folder only" in err


def test_the_command_measures_a_learning_curve(run, tmp_path, monkeypatch, rng):
    changed = OPTIONS | {"progress": False}
    monkeypatch.setattr(measure, "train", lambda data, **options: liaam.train(data, **options | changed))
    faces = tmp_path / "faces"
    many = [kite(np.random.default_rng(i)) for i in range(8)]
    write_labels(faces, many, rng, 0.0)
    for i, scene in enumerate(many):
        write_image(faces / f"f{i}.png", scene.image)
    options = ("--learning-curve", "-m", "grey", "--limit", 50, "-o", tmp_path / "out")
    code, out, err = run("evaluate", faces, *options)
    assert code == 0, err
    assert "forecast for 16 training images: median error" in out
    rows = list(csv.DictReader((tmp_path / "out/learning-curve.csv").open()))
    assert [row["pictures"] for row in rows] == ["5", "6"]
    read = json.loads((tmp_path / "out/learning-curve.json").read_text())
    low, high = read["forecast"]["interval_percent"]
    assert low < read["forecast"]["median_percent"] < high
    assert (tmp_path / "out/learning-curve.png").read_bytes()[:4] == b"\x89PNG"


def test_shapes_of_both_sides_are_compared_on_one(rng):
    """As if no object had been mirrored. Fits of the wrong side are counted, those put back to the start are not."""
    truths = np.array([[0.0, 0], [60, 5], [50, 40], [5, 30], [25, 20]]) + rng.normal(0, 3, (12, 5, 2))
    found = truths + rng.normal(0, 0.3, truths.shape)
    sign = np.where(np.arange(12)[:, None, None] % 3 == 0, [-1.0, 1.0], 1.0)

    def evaluated(truths: np.ndarray, landmarks: np.ndarray, sides: tuple[str, ...] = ()) -> Evaluation:
        return Evaluation(
            names=tuple(f"{i}" for i in range(12)),
            images=(None,) * 12,
            truths=truths,
            landmarks=landmarks,
            covariances=np.tile(np.eye(2), (12, 5, 1, 1)),
            qualities=np.ones(12),
            statuses=(FitStatus.CONVERGED,) * 12,
            sizes=np.full(12, 70.0),
            normaliser="the diagonal",
            limit=0.03,
            sides=sides,
        )

    plain = evaluated(truths, found).agreement
    names = tuple("mirrored" if i % 3 == 0 else "original" for i in range(12))
    both = evaluated(truths * sign, found * sign, names)
    assert plain is not None and both.agreement is not None
    at_start = replace(evaluated(truths, found), at_start=(True,) + (False,) * 11)
    assert at_start.agreement is not None and at_start.agreement.n_specimens == 11
    absent = replace(at_start, has_absent=(True,) * 3 + (False,) * 9)
    assert absent.agreement is not None and absent.agreement.n_estimated == 2
    assert both.agreement.slope == pytest.approx(plain.slope, abs=1e-9)
    assert not both.on_wrong_side.any()
    assert "sides: 4 mirrored, 8 original; fits of the wrong side: 0" in both.report()
    wrong = evaluated(truths * sign, found, names)
    assert wrong.on_wrong_side.tolist() == [i % 3 == 0 for i in range(12)]
    assert wrong.by_image()["wrong_side"][:2] == [True, False]
