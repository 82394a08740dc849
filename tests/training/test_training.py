"""Training: what comes out, and what is refused by name."""

import inspect
from collections import Counter
from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from liaam.datasets import Sample
from liaam.errors import ImageError, OptionError, TrainingError
from liaam.fitting import METHODS, FitStatus, Fitter, SolverOptions, fit
from liaam.io import Contour, Landmarks, read_image, write_image, write_landmarks
from liaam.io.fit_files import write_fit
from liaam.model import SURROUNDINGS, cost, load_model
from liaam.model.appearance import COPIED_APPEARANCES, AppearanceModel
from liaam.model.mesh import delaunay, signed_areas
from liaam.morphometry import measure, read_specimens
from liaam.photometry import CameraModel, invariant
from liaam.scale import Length
from liaam.training import TrainingOptions, images as images_of_training, train as train_as_users_do
from liaam.training.entries import known_of, read_entries, with_all_landmarks
from liaam.training.objects import describe_objects, folds_of, groups_of
from liaam.training.options import ARGUMENTS
from setups import disturb, model_pixels, train_on

LINEAR = CameraModel(response="linear")
# The scenes are faces, but light is not what most of these tests are about; tests/training/test_faces.py is.
train = partial(train_as_users_do, lamps=None)


@pytest.fixture
def pairs(scenes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Three images and landmarks, to be spoilt."""
    return [(scene.image.copy(), scene.landmarks.copy()) for scene in scenes[:3]]


def refused(pairs, match: str, **options) -> None:
    with pytest.raises((TrainingError, OptionError), match=match):
        train(pairs, **({"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,)} | options))


def test_a_model_that_could_not_be_read_again_is_refused_before_it_is_calibrated(pairs, monkeypatch):
    monkeypatch.setattr(cost, "MOST_WORK", 1e4)
    refused(pairs, r"the model of 3 images is too large.*Give a smaller diagonal \(now 40 pixels\)")


# What comes out


def test_the_frame_has_the_size_asked_for(model, fine_model):
    assert model.diagonal == pytest.approx(80)
    assert fine_model.diagonal == pytest.approx(150)
    assert fine_model.n_pixels / model.n_pixels == pytest.approx((150 / 80) ** 2, rel=0.05)


def test_all_modes_rebuild_the_training_textures(fine_model):
    for level in fine_model.levels:
        for appearance in level.appearances.values():
            flat = appearance.modes.reshape(appearance.n_modes, -1)
            np.testing.assert_allclose(flat @ flat.T, np.eye(appearance.n_modes), atol=1e-4)
            assert appearance.n_modes == 7
            assert (np.diff(appearance.eigenvalues) <= 0).all()


def test_the_invariant_of_the_mean_is_the_mean_of_the_invariant(fine_model):
    appearances = fine_model.levels[-1].appearances
    projected = invariant(appearances["log"].mean, fine_model.theta)
    np.testing.assert_allclose(appearances["invariant"].mean[:, 0], projected, atol=1e-5)


def test_blur_takes_detail_away(model):
    coarse, fine = (model.frame.picture(level.appearances["value"].mean) for level in model.levels)
    assert np.abs(np.diff(coarse[20:40, 15:40], axis=0)).mean() < np.abs(np.diff(fine[20:40, 15:40], axis=0)).mean()


def test_images_of_any_depth_train_the_same_model(scenes):
    eight = [(np.round(s.image * 255).astype(np.uint8), s.landmarks) for s in scenes[:3]]
    sixteen = [(image.astype(np.uint16) * 257, landmarks) for image, landmarks in eight]
    floats = [(image / 255.0, landmarks) for image, landmarks in eight]
    options = {"diagonal": 40.0, "variance": 1.0, "blurs": (0.0,), "leave_out": False}
    models = [train(pairs, **options) for pairs in (eight, sixteen, floats)]
    for other in models[1:]:
        for name, appearance in other.levels[0].appearances.items():
            np.testing.assert_allclose(appearance.mean, models[0].levels[0].appearances[name].mean, atol=1e-4)


def test_contours_and_mesh_come_from_the_landmarks(pairs):
    mesh = delaunay(pairs[0][1])
    contours = tuple(Contour(tuple(int(i) for i in t), True) for t in mesh)
    samples = [Sample(f"s{i}", image, Landmarks(points, contours=contours)) for i, (image, points) in enumerate(pairs)]
    model = train(samples, leave_out=False, **OPTIONS)
    assert model.contours[0] == (contours[0].indices, True)
    assert {tuple(sorted(t)) for t in model.triangles.tolist()} == {tuple(sorted(t)) for t in mesh.tolist()}


def test_contours_can_be_given(pairs):
    options = {"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,), "leave_out": False, "copies": 0}
    model = train(pairs, contours=[[0, 1, 2], [3, 4, 5, 3], ((6, 7), True)], **options)
    assert model.contours == (((0, 1, 2), False), ((3, 4, 5), True), ((6, 7), True))
    assert train(pairs, contours=model.contours, **options).contours == model.contours


@pytest.mark.parametrize("contours", [[[0, 1, 99]], [[0, -1]], [[2]], [["a", "b"]], [7]])
def test_contours_of_no_landmarks_are_refused(pairs, contours):
    with pytest.raises(TrainingError, match="give the indices of the landmarks along it, 0 to"):
        train(pairs, contours=contours)


def test_triangles_may_turn_either_way(pairs, model):
    for triangles in (model.triangles, model.triangles[:, ::-1]):
        trained = train(pairs, triangles=triangles, leave_out=False, **OPTIONS)
        assert (signed_areas(trained.shape_model.mean, trained.triangles) > 0).all()


def test_landmarks_just_beyond_the_border_are_no_fault(scenes):
    edges = [int(np.sort(s.landmarks[:, 0])[3]) + 1 for s in scenes[:4]]  # cuts four landmarks off, or five
    cut = [(s.image[:, x:], s.landmarks - [x, 0]) for s, x in zip(scenes[:4], edges, strict=True)]
    assert all(4 <= (points[:, 0] < 0).sum() <= 5 for _, points in cut)
    model = train(cut, leave_out=False, **OPTIONS)
    assert model.levels[-1].appearances["value"].usable.min() == 0


def test_progress_is_told(pairs):
    seen = []
    train(pairs, diagonal=40.0, camera=LINEAR, progress=lambda *step: seen.append(step))
    done, total, what = zip(*seen, strict=True)
    pictures = [step for i in (1, 2, 3) for step in (f"image {i}", f"a copy of image {i}")]
    assert what[:8] == (*pictures, "appearance of the mesh", "appearance of the mesh")
    assert what[11:] == (
        *(f"leaving out part {i} of 3" for i in (1, 2, 3)),
        *[f"fitting image {i}" for i in (1, 2, 3)] * 2,  # from near the objects, and from all other starts
        "trained",
    )
    assert len(set(total)) == 1
    assert done[0] == 0 and done[-1] == total[0] and (np.diff(done) > 0).all()


def test_training_holds_blas_to_one_thread(pairs):
    seen = set()
    train(pairs, progress=lambda *_: seen.update(info["num_threads"] for info in threadpool_info()), **OPTIONS)
    assert seen == {1}


def test_progress_is_shown_if_asked_for(pairs, capsys):
    for progress, shown in ((True, True), (False, False), (None, False)):  # by default on a terminal only
        train(pairs, diagonal=40.0, camera=LINEAR, variance=1.0, leave_out=False, progress=progress)
        assert ("training" in capsys.readouterr().err) == shown


def test_progress_counts_copies_where_parts_are_left_out(pairs):
    seen = []
    options = {"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,)}
    train(pairs * 4, progress=lambda *step: seen.append(step), **options)
    assert seen[-1] == (seen[-1][1], seen[-1][1], "trained")


def test_every_method_has_its_appearance(model):
    for method in METHODS.values():
        levels = model.views[method.view].levels
        assert levels
        assert all(method.appearance in level.appearances for level in levels)


# Pictures under other lights


def test_illumination_is_orthogonal_to_the_identity(model):
    for level in model.levels:
        value, light = level.appearances["value"], level.appearances["illumination"]
        flat = light.modes.reshape(light.n_modes, -1)
        assert light.n_modes >= 2
        np.testing.assert_allclose(flat @ flat.T, np.eye(light.n_modes), atol=1e-4)
        np.testing.assert_allclose(flat @ value.modes.reshape(value.n_modes, -1).T, 0, atol=1e-4)
        np.testing.assert_allclose(flat @ value.mean.ravel() / np.linalg.norm(value.mean), 0, atol=1e-4)


def test_lamps_change_only_what_learns_from_copies(model, scenes):
    plain = train_on(scenes, diagonal=80.0)
    for name in ("mean", "modes", "eigenvalues"):
        assert np.array_equal(getattr(plain.shape_model, name), getattr(model.shape_model, name))
    for without, level in zip(plain.levels, model.levels, strict=True):
        assert set(level.appearances) - set(without.appearances) == {"varied", "illumination"}
        for name in {*without.appearances} - {*COPIED_APPEARANCES}:
            for part in fields(AppearanceModel):
                ours, theirs = (getattr(at.appearances[name], part.name) for at in (without, level))
                assert np.array_equal(ours, theirs), (name, part.name)


def test_no_copies_teach_nothing_of_light(pairs, lamps):
    for options in ({"copies": 0, "lamps": lamps}, {"copies": 2}):
        model = train(pairs, diagonal=40.0, leave_out=False, **options)
        assert not {"varied", "illumination"} & set(model.levels[0].appearances)


@pytest.mark.parametrize(("variance", "agree"), [(1.0, True), (0.8, False)])
def test_aia_and_varied_are_one_where_all_modes_are_kept(scenes, lamps, lit_scene, variance, agree):
    # Both then compare with the span of all pictures: gain makes the mean a mode like any other.
    options = {"variance": 1.0, "appearance_variance": variance, "lamps": lamps, "copies": 1}
    model = train_on(scenes, diagonal=80.0, blurs=(0.5,), **options)
    start = disturb(lit_scene.landmarks, 1.01, (0.01, -0.01))
    options = SolverOptions(max_iterations=100, tolerance=1e-4)
    aia, varied = (Fitter(model, name, options).fit(lit_scene.image, start) for name in ("aia", "varied"))
    apart = model_pixels(model, aia.landmarks, varied.landmarks)
    if agree:
        assert apart < 0.01
        assert aia.cost == pytest.approx(varied.cost, rel=1e-3)
    else:
        assert apart > 0.05
        assert aia.cost != pytest.approx(varied.cost, rel=0.01)


# What is refused


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_images_are_refused(pairs, n):
    refused(pairs[:n], f"{n} landmarked images?: too few to learn from; at least 3")


def test_counts_that_differ_are_refused(pairs):
    pairs[1] = (pairs[1][0], pairs[1][1][:-1])
    refused(pairs, "image 2 has 57 landmarks but image 1 has 58")


def test_missing_landmarks_are_estimated_from_the_other_images(pairs, recwarn):
    true = pairs[0][1].copy()
    for i, (_, points) in enumerate(pairs):
        points[i] = np.nan
    data = read_entries(pairs)
    np.testing.assert_array_equal(known_of(data.entries), ~np.eye(3, 58, dtype=bool))
    entries = with_all_landmarks(data, folds_of(data.names)).entries
    assert not recwarn.list
    assert np.linalg.norm(entries[0].points[0] - true[0]) < 0.1 * np.ptp(true, axis=0).max()
    np.testing.assert_array_equal(entries[0].points[1:], true[1:])


def test_images_with_hardly_any_landmarks_are_left_out_by_name(pairs):
    pairs = [*pairs[:3], (pairs[0][0], pairs[0][1].copy())]
    pairs[2][1][2:] = np.nan
    with pytest.warns(UserWarning, match=r"1 image has fewer than 3 landmarks and is left out: image 3 \(2\); place"):
        entries = read_entries(pairs).entries
    assert [entry.name for entry in entries] == ["image 1", "image 2", "image 4"]
    pairs[2][1][:] = np.nan
    refused(pairs, "image 3: all of its 58 landmarks are missing")


def test_too_few_images_with_landmarks_are_refused(pairs):
    pairs[1][1][1:] = np.nan
    with pytest.warns(UserWarning, match=r"left out: image 2 \(1\)"):
        refused(pairs, "2 landmarked images: too few to learn from")


def test_a_landmark_that_is_missing_in_all_images_is_refused_by_its_number(pairs):
    for _, points in pairs:
        points[[4, 9]] = np.nan
    refused(pairs, "landmarks 5, 10 are missing in all 3 images: place them in some images, or remove them from all")
    for _, points in pairs:
        points[4] = 50.0
    refused(pairs, "landmark 10 is missing in all 3 images: place it in some images, or remove it from all")
    names = [f"p{i}" for i in range(58)]
    named = [(image, Landmarks(points, (), names)) for image, points in pairs]
    refused(named, r"landmark 10 \(p9\) is missing in all 3 images")


def test_sides_that_are_never_placed_together_are_refused(scenes):
    pairs = [(scene.image, scene.landmarks.copy()) for scene in scenes[:5]]
    for i, (_, points) in enumerate(pairs):
        points[slice(30, None) if i % 2 else slice(0, 30)] = np.nan
    refused(
        pairs,
        r"some images \(image 1, image 3, image 5\) share fewer than 2 landmarks with others \(image 2, image 4\), so "
        "nothing says where landmarks 31–58 lie relative to landmarks 1–30: place both in some images, or train on one",
    )


def test_a_landmark_that_one_image_has_is_said(pairs):
    for _, points in pairs[1:]:
        points[7] = np.nan
    with pytest.warns(UserWarning, match="landmark 8 is placed in only 1 of 3 images, from which little can be learnt"):
        read_entries(pairs)


def test_warnings_of_samples_name_the_line_that_calls_train(scenes):
    pairs = [(scene.image, scene.landmarks.copy()) for scene in scenes[:5]]
    for _, points in pairs[1:]:
        points[30] = np.nan
    pairs[2][1][2:] = np.nan
    with pytest.warns(UserWarning, match="landmark") as caught:
        train(pairs, diagonal=40.0, camera=LINEAR, blurs=(0.0,), leave_out=False)
    few, rare = (each for each in caught if "landmark" in str(each.message))
    assert "fewer than 3 landmarks" in str(few.message) and "only 1 of 4 images" in str(rare.message)
    assert few.filename == rare.filename == __file__


@pytest.mark.parametrize("bad", [np.zeros((58, 3)), np.zeros(58), np.zeros((2, 2))])
def test_landmarks_that_are_no_points_are_refused(pairs, bad):
    pairs[0] = (pairs[0][0], bad)
    refused(pairs, "image 1: landmarks of shape .* are not")


def test_landmarks_in_one_place_are_refused(pairs):
    pairs[0][1][:] = 50
    refused(pairs, "image 1: all landmarks lie within 2 pixels")


def test_landmarks_on_a_line_are_refused(pairs):
    line = [(image, np.column_stack([points[:, 0], points[:, 0]])) for image, points in pairs]
    refused(line, "lie on one line or at one point")


def test_samples_that_fold_the_mesh_are_left_out_by_name(scenes, rng, monkeypatch):
    pairs = [(s.image, s.landmarks.copy()) for s in scenes]
    pairs[4] = (pairs[4][0], rng.permutation(pairs[4][1]))
    pairs[6] = (pairs[6][0], rng.permutation(pairs[6][1]))
    options = {"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,), "leave_out": False}
    read, inspect = Counter(), images_of_training._inspect
    monkeypatch.setattr(images_of_training, "_inspect", lambda *given: read.update([given[-1].name]) or inspect(*given))
    with pytest.warns(UserWarning, match=r"2 of 8 images fold the mesh .*image 5 \(.*image 7 \(.*left out.*misplaced"):
        made = train(pairs, **options)
    assert made.n_images == 6
    assert set(read.values()) == {1}  # each image is checked once
    with pytest.raises(TrainingError, match=r"2 of 8 images fold the mesh .*image 5 "):
        train(pairs, strict=True, **options)
    sound = train([pair for i, pair in enumerate(pairs) if i not in (4, 6)], **options)
    np.testing.assert_array_equal(made.shape_model.mean, sound.shape_model.mean)


def test_samples_that_fold_the_mesh_are_refused_if_too_few_are_left(scenes, rng):
    pairs = [(s.image, s.landmarks.copy()) for s in scenes[:3]]
    pairs[2] = (pairs[2][0], rng.permutation(pairs[2][1]))
    refused(pairs, "of 3 images fold the mesh .*same order")


def test_folded_triangles_are_refused(pairs, model):
    triangles = model.triangles.copy()
    triangles[3] = triangles[3, ::-1]
    refused(pairs, "the mesh is folded on the mean shape", triangles=triangles)


@pytest.mark.parametrize(
    "triangles", [[[0, 1, 58]], [[-1, 0, 1]], [[0.0, 1.0, 2.0]], [[0, 1]], np.zeros((0, 3), int), [0, 1, 2]]
)
def test_triangles_that_are_none_are_refused(pairs, triangles):
    refused(pairs, r"triangles must be \(t, 3\) integers from 0 to 57", triangles=triangles)


def test_an_unexposed_image_is_refused_by_name(pairs):
    pairs[1][0][:] = 0.0
    refused(pairs, "image 2: the object is almost completely black")


@pytest.mark.parametrize("suffix", [".ljson", ".tps"])
def test_images_and_landmarks_may_be_files(pairs, tmp_path, suffix):
    (tmp_path / "marks").mkdir()
    files = []
    for i, (image, points) in enumerate(pairs):
        files.append((tmp_path / f"face{i}.png", str(tmp_path / f"marks/face{i}{suffix}")))
        write_image(files[-1][0], np.rint(image * 255).astype(np.uint8))
        write_landmarks(files[-1][1], points, image.shape[1::-1])
    arrays = [(read_image(image), landmarks) for image, landmarks in files]
    models = [train(given, diagonal=40.0, camera=LINEAR, variance=1.0, leave_out=False) for given in (files, arrays)]
    means = [model.levels[-1].appearances["log"].mean for model in models]
    np.testing.assert_array_equal(*means)


def test_landmarks_of_which_half_are_upside_down_are_refused_with_both_remedies():
    image, points = np.full((60, 60, 3), 0.5), np.array([[10.0, 10], [30, 20], [12, 50], [20, 30], [10, 30], [14, 40]])
    upside_down = points * [1, -1] + [0, 59]
    said = "their mean lies on one line: many seem to have y counted from the other border.*state the sides"
    refused([(image, points), (image, upside_down)] * 2, said)


def test_names_of_landmarks_are_kept_until_they_are_measured(pairs, tmp_path):
    n = len(pairs[0][1])
    names = tuple(f"p{i}" for i in range(n))
    named = [(image, Landmarks(points, names=names)) for image, points in pairs[:2]]
    train([*named, pairs[2]], diagonal=40.0, camera=LINEAR, variance=1.0, leave_out=False).save(tmp_path / "m")
    model = load_model(tmp_path / "m")
    assert model.landmark_names == names
    result = Fitter(model).fit(pairs[0][0], pairs[0][1])
    assert result.landmark_names == names
    write_fit(tmp_path / "a.json", Landmarks(result.landmarks, names=names), result.to_dict(), (180, 240))
    distance = measure(read_specimens(tmp_path), ["distance:p3-p9"])["distance_p3_p9"]
    assert distance[0] == pytest.approx(np.linalg.norm(result.landmarks[3] - result.landmarks[9]))


def test_landmarks_go_by_their_names(pairs):
    n = len(pairs[0][1])
    names = [f"point {i}" for i in range(n)]
    order = [*range(4), 5, 4, *range(6, n)]
    true = pairs[2][1].copy()
    for i in range(2):
        pairs[i] = (pairs[i][0], Landmarks(pairs[i][1], names=tuple(names)))
    pairs[2] = (pairs[2][0], Landmarks(true[order], names=tuple(names[i] for i in order)))
    data = read_entries(pairs)
    assert data.landmark_names == tuple(names)
    np.testing.assert_array_equal(data.entries[2].points, true)
    pairs[2] = (pairs[2][0], Landmarks(true, names=("other", *names[1:])))
    refused(pairs, "image 3: its names lack point 0")
    pairs[2] = (pairs[2][0], Landmarks(true, names=tuple(f"other {i}" for i in range(n))))
    assert read_entries(pairs).landmark_names == ()  # images do not agree


def test_values_of_twelve_bits_in_sixteen_are_refused_by_name(pairs):
    pairs[1] = ((pairs[1][0] * 4095).astype(np.uint16), pairs[1][1])
    with pytest.raises(ImageError, match=r"image 2: its 16-bit values reach only .* multiply 12-bit values by 16"):
        train(pairs, diagonal=40.0, variance=1.0)


def test_an_overexposed_image_is_refused_by_name(pairs):
    pairs[1][0][:] = 1.0
    refused(pairs, "image 2: the object is almost completely saturated")


def test_an_image_of_nan_is_refused_by_name(pairs):
    pairs[1][0][:] = np.nan
    refused(pairs, "image 2: the object is almost completely")


def test_a_few_nan_pixels_cost_their_pixels_only(pairs, rng):
    clean = train(pairs, leave_out=False, **OPTIONS)
    pairs[1][0][rng.random(pairs[1][0].shape[:2]) < 0.01] = np.nan
    model = train(pairs, leave_out=False, **OPTIONS)
    a, b = (m.levels[-1].appearances["log"] for m in (model, clean))
    assert 0.8 < a.usable.mean() / b.usable.mean() < 1.0
    everywhere = (a.usable == 1) & (b.usable == 1)
    assert np.abs(a.mean - b.mean)[everywhere].mean() < 0.02


@pytest.mark.parametrize("shift", [500, -500])
def test_landmarks_outside_the_image_are_refused(pairs, shift):
    pairs[0][1][:] += shift
    refused(pairs, "image 1: 58 of 58 landmarks lie outside the image of 180×240 pixels")


def test_one_landmark_far_outside_is_refused_rather_than_called_a_fold(pairs):
    pairs[1][1][7] = [-400.0, 120.0]
    refused(pairs, r"image 2: 1 of 58 landmarks lie outside .* \(point 8 by 400 pixels\)\. Check")


def test_all_images_whose_landmarks_lie_outside_are_named(pairs):
    for i in (0, 2):
        pairs[i][1][:] *= 5.0
    refused(pairs, r"image 1: .* outside .*; image 3: .* outside .*correct or remove them")


def test_a_third_of_the_object_may_lie_outside(scenes):
    pairs = [(scene.image, scene.landmarks) for scene in scenes[:5]]
    image, points = pairs[0]
    cut = int(np.quantile(points[:, 0], 0.35))
    pairs[0] = (image[:, cut:], points - [cut, 0])
    model = train(pairs, diagonal=40.0, camera=LINEAR, leave_out=False, methods=["grey"])
    assert model.levels[-1].appearances["value"].usable.min() == pytest.approx(0.8)


def grey_of(image):
    return np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2)


@pytest.fixture
def mixed(scenes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Five images and landmarks, of which the second and the fifth image are grey."""
    return [
        (grey_of(scene.image) if i in (1, 4) else scene.image, scene.landmarks) for i, scene in enumerate(scenes[:5])
    ]


OPTIONS = {"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,), "variance": 1.0, "methods": "all"}


def test_grey_images_among_colours_teach_shape_and_gradients_only(mixed):
    with pytest.warns(UserWarning, match=r"^2 of 5 images are grey \(image 2, image 5\): soft-li learns"):
        model = train(mixed, copies=1, leave_out=True, **OPTIONS)
    colours = train([mixed[i] for i in (0, 2, 3)], copies=1, leave_out=False, **OPTIONS)
    assert model.is_colour
    assert len(model.shape_model.modes) == 4
    own, of_colours = model.levels[0].appearances, colours.levels[0].appearances
    assert {name: own[name].n_modes for name in ("value", "log", "invariant")} == {"value": 2, "log": 2, "invariant": 2}
    # Shapes differ, so that the meshes are not the same, but the colours are.
    assert np.abs(own["value"].mean.mean(axis=0) - of_colours["value"].mean.mean(axis=0)).max() < 0.01
    soft = model.views[SURROUNDINGS].levels[0].appearances["soft"]
    assert soft.n_modes > colours.views[SURROUNDINGS].levels[0].appearances["soft"].n_modes
    assert np.abs(soft.mean[..., 2]).mean() > 0.9 * np.abs(of_colours["invariant"].mean).mean()


def test_relit_copies_of_grey_images_teach_no_colours(mixed, monkeypatch):
    """Lamps change colours, but a relit grey image has no invariant of the object."""
    monkeypatch.setattr(
        "liaam.training.lamps.Copies.of_picture", lambda _self, _i, image, points, *_: [(image * [1, 0.8, 0.6], points)]
    )
    with pytest.warns(UserWarning):
        soft = train(mixed, copies=1, leave_out=False, **OPTIONS).views[SURROUNDINGS].levels[0].appearances["soft"]
    colours = train([mixed[i] for i in (0, 2, 3)], copies=1, leave_out=False, **OPTIONS)
    expected = colours.views[SURROUNDINGS].levels[0].appearances["soft"]
    assert soft.mean[..., 2].mean() == pytest.approx(expected.mean[..., 2].mean(), abs=0.02)


def test_too_few_colour_images_are_used_as_grey(mixed):
    with pytest.warns(
        UserWarning, match=r"only 2 of 4 images are in colour \(image 1, image 3\); all are used as grey"
    ):
        model = train([mixed[i] for i in (0, 1, 2, 4)], leave_out=False, **OPTIONS)
    assert not model.is_colour
    assert np.ptp(model.levels[0].appearances["value"].mean, axis=1).max() < 1e-5


def test_colour_images_that_are_all_left_out_together_leave_something_to_learn_from(scenes):
    """The folds of a grey majority may hold all colour images in one."""
    many = [(grey_of(scenes[i % 8].image), scenes[i % 8].landmarks + i / 8) for i in range(30)]
    many[:3] = [(scenes[i].image, scenes[i].landmarks) for i in range(3)]
    with pytest.warns(UserWarning, match="27 of 30 images are grey"):
        model = train(many, leave_out=False, **{**OPTIONS, "variance": "auto"})
    assert np.isfinite(model.levels[0].appearances["log"].unexplained).all()


def test_an_image_of_one_pixel_is_refused_by_name(pairs):
    pairs[2] = (np.zeros((1, 1, 3), np.uint8), pairs[2][1])
    with pytest.raises(ImageError, match="image 3: the image is 1×1 pixels"):
        train(pairs)


@pytest.mark.parametrize("diagonal", [0, 15.9, 2001, np.nan, np.inf, -50])
def test_a_frame_of_no_sensible_size_is_refused(pairs, diagonal):
    refused(pairs, "give the size of the reference frame, 16 to 2000", diagonal=diagonal)


@pytest.mark.parametrize("blurs", [(), (0.5, 3.0), (-1.0,), (11.0,), (np.nan,), (3.0, np.nan)])
def test_blurs_that_make_no_sense_are_refused(pairs, blurs):
    refused(pairs, "from coarse to fine", blurs=blurs)


@pytest.mark.parametrize("option", ["variance", "appearance_variance"])
def test_a_variance_that_makes_no_sense_is_refused(pairs, option):
    refused(pairs, r"give a fraction in \(0, 1\]", **{option: 98.0})


def test_identical_images_leave_no_modes(scenes):
    model = train_on([scenes[0]] * 3, diagonal=40.0)
    assert len(model.shape_model.modes) == 0
    assert model.levels[0].appearances["log"].n_modes == 0


def test_pictures_of_one_object_are_left_out_together():
    names = [f"{person:02d}-{i}m" for person in range(4) for i in range(3)]
    assert [fold.tolist() for fold in folds_of(names)] == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    shuffled = ["anna1", "bob1", "carl1", "anna2", "bob2", "carl2"]
    assert [fold.tolist() for fold in folds_of(shuffled)] == [[0, 3], [1, 4], [2, 5]]
    several = ["anna1", "bob1", "carl1", "anna1#2", "bob2", "carl2"]
    assert [fold.tolist() for fold in folds_of(several)] == [[0, 3], [1, 4], [2, 5]]


def test_pictures_whose_names_tell_nothing_are_left_out_one_by_one_or_in_a_few_folds():
    assert [fold.tolist() for fold in folds_of(["face1", "face2", "face3"])] == [[0], [1], [2]]
    assert describe_objects(["face1", "face2", "face3"]) == describe_objects(["anna", "bob", "carl"]) == ""
    together = (
        "images of the same object, by their names: anna (2), bob (1), carl (1); cross-validation leaves them out "
        "together"
    )
    assert describe_objects(["anna-1", "bob-1", "anna-2", "carl-1"]) == together
    assert describe_objects(["1", "2", "a1", "b1"]) == ""  # numbers alone name no object
    folds = folds_of([f"face{i}" for i in range(50)])
    assert len(folds) == 5
    assert sorted(np.concatenate(folds)) == list(range(50))


@pytest.mark.parametrize(
    "name",
    [
        "{fly}_{side}",
        "{side}/{fly}",
        "{side}/{fly}.png",
        "{side}_{fly}",
        "day 1/{side}/{fly}",
        "day 1/{fly}_{side}",
        "{L}/{fly}",
        "{fly}{L}",
        "sp_{fly}_{side}",
    ],
)
def test_both_sides_of_an_individual_are_left_out_together(name):
    names = [
        name.format(fly=f"ind{i:02d}", side=side, L=side[0].upper()) for side in ("left", "right") for i in range(6)
    ]
    assert [group.tolist() for group in groups_of(names)] == [[i, i + 6] for i in range(6)]
    assert describe_objects(names).startswith("images of the same object")


@pytest.mark.parametrize(
    "name", ["{fly}_{side}_{i}", "{fly}_{side}{i}", "{side}/{fly}_{i}", "{side}/{fly}-{i}.jpg", "a/{side}/{fly} {i}"]
)
def test_several_images_of_both_sides_are_left_out_together(name):
    names = [name.format(fly=f"ind{fly}", side=side, i=i) for side in ("left", "right") for fly in "123" for i in "12"]
    assert [group.tolist() for group in groups_of(names)] == [[0, 1, 6, 7], [2, 3, 8, 9], [4, 5, 10, 11]]


def test_a_side_alone_makes_no_individuals():
    assert describe_objects([f"left/ind{i}" for i in range(6)]) == ""
    assert describe_objects([f"{side}/ind{i}" for i in range(2) for side in ("left", "right")]) == ""  # too few


def test_pictures_left_out_are_given_as_they_are(pairs, left_out_images):
    """The fit itself takes vignetting off; twice would be once too often."""
    camera = CameraModel(response="linear", vignetting=(-0.3,))
    train(pairs, diagonal=40.0, camera=camera)
    assert len(left_out_images) == len(pairs)
    for left_out, (image, points) in zip(left_out_images, pairs, strict=True):
        np.testing.assert_array_equal(left_out.image, image)
        np.testing.assert_array_equal(left_out.points, points)
        assert len(left_out.model.views[SURROUNDINGS].levels) == 3


@pytest.mark.parametrize("prior", ["sample", "shrunk", "smooth", "wide"])
def test_models_that_leave_pictures_out_are_learnt_in_the_same_way(scenes, left_out_images, prior):
    options = {"diagonal": 40.0, "blurs": (1.0,), "prior": prior}
    model = train_on(scenes[:5], variance=3, leave_out=True, **options)
    assert len(model.views[SURROUNDINGS].shape_model.modes) == 3
    assert len(left_out_images) == 5
    parts = [left_out.model.views[SURROUNDINGS].shape_model for left_out in left_out_images]
    assert {len(part.modes) for part in parts} == {3}
    assert all(np.abs(part.modes - model.views[SURROUNDINGS].shape_model.modes).max() > 1e-3 for part in parts)


def test_modes_are_counted_by_evidence_of_shapes_and_appearances_alike(scenes, left_out_images):
    options = {"diagonal": 40.0, "blurs": (1.0,)}
    model = train_on(scenes, variance="auto", leave_out=True, **options)
    for count in (len(model.shape_model.modes), model.views[SURROUNDINGS].levels[0].appearances["soft"].n_modes):
        assert 0 <= count < len(scenes) - 1  # fewer than there are: some of the variance is noise
    part = left_out_images[0].model.views[SURROUNDINGS]
    assert len(part.shape_model.modes) <= len(model.views[SURROUNDINGS].shape_model.modes)


def test_a_smooth_prior_knows_more_shapes_than_the_pictures_show(pairs):
    options = {"diagonal": 40.0, "camera": LINEAR, "blurs": (1.0,), "leave_out": False}
    sample, smooth = (train(pairs, prior=prior, **options) for prior in ("sample", "smooth"))
    assert len(sample.shape_model.modes) == 2
    assert len(smooth.shape_model.modes) > 5
    assert smooth.shape_model.left_out_bound < sample.shape_model.left_out_bound
    assert smooth.views[SURROUNDINGS].shape_model is smooth.shape_model  # one will do
    for prior in (None, {SURROUNDINGS: "smooth"}):
        both = train(pairs, prior=prior, **options)
        np.testing.assert_array_equal(both.shape_model.modes, sample.shape_model.modes)
        np.testing.assert_array_equal(both.views[SURROUNDINGS].shape_model.modes, smooth.shape_model.modes)


def test_the_views_share_one_mean_shape(pairs):
    model = train(pairs, diagonal=40.0, blurs=(1.0,), leave_out=False)
    mesh, around = (view.shape_model for view in model.views.values())
    assert mesh is not around
    np.testing.assert_array_equal(mesh.mean, around.mean)


@pytest.mark.parametrize("options", [{"variance": 1.0}, {"prior": "shrunk"}, {"prior": {SURROUNDINGS: "sample"}}])
def test_the_views_share_their_shapes_where_that_is_asked(pairs, options):
    model = train(pairs, diagonal=40.0, blurs=(1.0,), leave_out=False, **options)
    assert model.views[SURROUNDINGS].shape_model is model.shape_model


def test_each_view_has_its_own_levels(pairs):
    options = {"diagonal": 40.0, "leave_out": False}
    both = train(pairs, blurs=(2.0,), **options)
    assert [[level.blur for level in view.levels] for view in both.views.values()] == [[2.0], [2.0]]
    one = train(pairs, blurs={SURROUNDINGS: (2.0,)}, **options)
    assert [[level.blur for level in view.levels] for view in one.views.values()] == [[3.0, 0.5], [2.0]]
    refused(pairs, "blurs: unknown view 'ears'; choose from mesh, surroundings", blurs={"ears": (1.0,)})


def test_many_landmarks_have_no_smooth_deformations_unasked(pairs, monkeypatch):
    monkeypatch.setattr("liaam.training.options.MOST_SMOOTH", len(pairs[0][1]) - 1)
    model = train(pairs, diagonal=40.0, blurs=(1.0,), leave_out=False)
    assert model.views[SURROUNDINGS].shape_model is model.shape_model


def test_a_prior_that_does_not_exist_is_refused(pairs):
    for prior in ("flat", {SURROUNDINGS: "flat"}):
        refused(pairs, "unknown prior 'flat'; choose from sample, shrunk, smooth", prior=prior)


@pytest.mark.parametrize("bad", ["ab", [["a", "b"]] * 5, [[1, 2], [3]]])
def test_landmarks_that_are_no_numbers_are_refused(pairs, bad):
    pairs[1] = (pairs[1][0], bad)
    refused(pairs, "image 2: the landmarks are not numbers")


@pytest.mark.parametrize("height", [0.015, 1e-3, 1e-12])
def test_landmarks_almost_on_a_line_are_refused(pairs, height):
    flat = [(image, points * [1, height] + [0, 50]) for image, points in pairs]
    refused(flat, "lie on one line or at one point, or almost so")


def test_options_come_as_an_object_by_name_or_both(pairs):
    options = TrainingOptions(diagonal=40.0, blurs=(1.0,), leave_out=False)
    by_object = train(pairs, options)
    by_name = train(pairs, diagonal=40.0, blurs=(1.0,), leave_out=False)
    assert by_object.to_bytes() == by_name.to_bytes()
    assert train(pairs, options, diagonal=50.0).diagonal == pytest.approx(50.0)
    refused(pairs, "unknown option 'size'; choose from diagonal, variance", size=3)
    refused(pairs, ".* camera, lamps, .*; did you mean 'features'", featurs=None)
    refused(pairs, "unknown option 'response'; .*; give camera=CameraModel", response="linear")


def test_messages_list_all_arguments_of_train():
    given = set(inspect.signature(train_as_users_do).parameters) - {"data", "options", "changes"}
    assert set(ARGUMENTS) == given


def rod(rng: np.random.Generator, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture and outline of a patterned rod so many times as long as wide."""
    import cv2

    def blotches(seed: np.random.Generator, rows: int, columns: int, size: tuple[int, int]) -> np.ndarray:
        values = seed.uniform(40, 230, (rows, columns, 3)).astype(np.float32)
        return cv2.resize(values, size, interpolation=cv2.INTER_CUBIC)

    length, width = 400 * rng.uniform(0.93, 1.07), 400 / ratio * rng.uniform(0.93, 1.07)
    centre, angle = rng.uniform(195, 215, 2) + np.array([60, 0]), rng.uniform(-0.3, 0.3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    along, across = np.moveaxis((np.stack(np.mgrid[:400, :540][::-1], axis=-1) - centre) @ turn, -1, 0)
    image = blotches(rng, 9, 12, (540, 400))
    places = [
        ((part / size + 0.5) * n).astype(np.float32) for part, size, n in ((along, length, 799), (across, width, 79))
    ]
    pattern = cv2.remap(blotches(np.random.default_rng(5), 4, 40, (800, 80)), *places, cv2.INTER_LINEAR)
    inside = (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
    image[inside] = pattern[inside]
    x = np.linspace(-length / 2, length / 2, 8)
    outline = np.concatenate([np.column_stack([x, 0 * x - width / 2]), np.column_stack([x[::-1], 0 * x + width / 2])])
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7), 0, 255).astype(np.uint8), outline @ turn.T + centre


def test_objects_many_times_as_long_as_wide_are_trained_and_fitted():
    rng = np.random.default_rng(3)
    rods = [rod(rng, 40) for _ in range(6)]
    model = train(rods[:5], diagonal=200.0, leave_out=False, methods=["li"])
    assert (signed_areas(model.shape_model.mean, model.triangles) > 0).all()
    image, outline = rods[5]
    result = Fitter(model, "li").fit(image, outline + np.array([3, 2]))
    assert result.status.ok
    assert np.abs(result.landmarks - outline).max() < 1


def test_a_scale_that_all_training_images_have_is_kept_in_the_model(pairs, tmp_path):
    scaled = [(image, Landmarks(points, scale=0.05, unit="mm")) for image, points in pairs]
    options = {"diagonal": 40.0, "camera": LINEAR, "blurs": (0.0,), "leave_out": False}
    model = train(scaled, **options)
    assert model.scale == Length(0.05, "mm", source="the training images")
    model.save(tmp_path / "a.liaam")
    assert load_model(tmp_path / "a.liaam").scale == model.scale
    assert train([*scaled[:-1], pairs[-1]], **options).scale is None


def test_fits_are_doubtful_where_fits_to_left_out_images_fail(rng, tmp_path):
    """Landmarks that have nothing to do with their images: a fit may converge, but nothing says that it is right."""
    import cv2

    points = np.array([[20.0, 20], [60, 18], [62, 60], [22, 64], [40, 40]])
    images = [cv2.resize(rng.integers(0, 255, (9, 9, 3), np.uint8), (90, 90)) for _ in range(6)]
    pairs = [(image, points + rng.normal(0, 6, points.shape)) for image in images]
    model = train(pairs, diagonal=40, regressor=False, shapes=1)
    assert model.failing_methods == ("soft-li",) and not model.calibrated
    model.save(tmp_path / "m.liaam")
    loaded = load_model(tmp_path / "m.liaam")
    assert loaded.failing_methods == model.failing_methods
    results = [fit(loaded, image, points) for image in images]
    assert not any(result.status.ok for result in results)
    doubtful = [result for result in results if result.status is FitStatus.DOUBTFUL]
    assert doubtful and all("nothing says that it is right" in result.message for result in doubtful)
    without = train(pairs, diagonal=40, leave_out=False, shapes=1)
    assert without.failing_methods == ()  # nobody looked
