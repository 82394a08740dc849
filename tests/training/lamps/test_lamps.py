"""Lamps: learnt from objects that did not move, laid on others, kept in files, and what models gain by them."""

import json
from dataclasses import replace
from inspect import signature

import numpy as np
import pytest

from liaam.datasets import Sample
from liaam.error_measures import point_error, root_mean_square
from liaam.errors import LiaamError, ModelFileError, TrainingError
from liaam.fitting import Fitter
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.model import load_model
from liaam.model.light_basis import SIDE
from liaam.model.shape import align, diagonal_of, mirror_order
from liaam.photometry import from_linear, srgb_to_linear
from liaam.relighting import Relighter
from liaam.training import left_out, train
from liaam.training.lamps import Copies, LearntLamps, learn_lamps, load_lamps
from liaam.training.lamps.bank import FADED, GAMMA, SHARP, _away_from, as_srgb
from liaam.training.lamps.copies import mirrored
from scenes import DIFFUSE, Head, Pose, lateral, make_set, random_expression, random_pose, render
from setups import disturb

SIZE = (160, 120)
LIGHTS = {"day": DIFFUSE, "left": lateral("left"), "right": lateral("right")}


def sample(name: str, image: np.ndarray, points: np.ndarray) -> Sample:
    return Sample(name, image, Landmarks(points))


def photographed(head: int, seed: int, lights=LIGHTS) -> list[Sample]:
    """One head in one pose under each light."""
    rng = np.random.default_rng(seed)
    pose, expression = random_pose(rng, SIZE), random_expression(rng)
    scenes = {name: render(Head(head), pose, expression, light, size=SIZE) for name, light in lights.items()}
    return [sample(f"head{head}-{name}", scene.image, scene.landmarks) for name, scene in scenes.items()]


@pytest.fixture(scope="module")
def pictures() -> list[Sample]:
    return [*photographed(2, 2), *photographed(3, 3)]


@pytest.fixture(scope="module")
def lamps(pictures) -> LearntLamps:
    return learn_lamps(pictures, "day")


# Learning and relighting


def test_there_is_a_lamp_for_each_picture_in_another_light(lamps):
    assert lamps.names == ("head2-left", "head2-right", "head3-left", "head3-right")
    assert lamps.fields.shape == (4, SIDE, SIDE, 3)
    assert diagonal_of(lamps.mean) == pytest.approx(1.0)
    assert np.allclose(lamps.mean.min(axis=0), -lamps.mean.max(axis=0))


def test_an_object_under_its_own_lamp_is_the_picture_that_was_taken(pictures, lamps):
    day, left = pictures[0], pictures[1]
    (made,) = lamps.relit(day.image, day.landmarks.points, [0])
    # Inside the face: at its outline the blur of the field shows.
    points, centre = day.landmarks.points, day.landmarks.points.mean(axis=0)
    x, y = np.rint(centre + 0.6 * (points - centre)).astype(int).T
    before, after = (np.abs(image[y, x].astype(float) - left.image[y, x]).mean() for image in (day.image, made))
    assert after < 0.35 * before


def test_a_lamp_of_one_head_brings_another_nearer_to_its_light(pictures, lamps):
    day, left, right = photographed(7, 11)
    points = day.landmarks.points
    x, y = np.rint(points[:40]).astype(int).T
    for number, lit in ((0, left), (1, right)):
        (made,) = lamps.relit(day.image, points, [number])
        before, after = (np.abs(image[y, x].astype(float) - lit.image[y, x]).mean() for image in (day.image, made))
        assert after < 0.7 * before


def test_fields_follow_the_landmarks(pictures, lamps):
    """The picture moved, turned and enlarged is relit alike, as far as resampling allows."""
    day = pictures[0]
    wide = np.repeat(np.repeat(day.image, 2, axis=0), 2, axis=1)
    (small,), (large,) = (
        lamps.relit(day.image, day.landmarks.points, [1]),
        lamps.relit(wide, 2.0 * day.landmarks.points + 0.5, [1]),
    )
    assert np.abs(large[::2, ::2].astype(float) - small).mean() < 1.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("response", ["srgb", "linear", 1.8])
def test_pictures_of_any_camera_are_relit_alike(pictures, lamps, dtype, response):
    day = pictures[0]
    expected = lamps.relit(day.image, day.landmarks.points, [0])[0] / 255.0
    values = from_linear(srgb_to_linear(day.image / 255.0), response)
    image = values.astype(np.float32) if dtype is np.float32 else np.rint(values * np.iinfo(dtype).max).astype(dtype)
    (made,) = lamps.relit(image, day.landmarks.points, [0], response)
    assert made.dtype == dtype
    assert np.abs(as_srgb(made, response) - expected).mean() < (0.03 if dtype is np.uint8 else 0.01)


def test_grey_pictures_stay_grey_and_faults_stay_finite(lamps, pictures):
    points = pictures[0].landmarks.points
    grey = np.repeat(pictures[0].image[..., :1], 3, axis=2)
    assert np.ptp(lamps.relit(grey, points, [0])[0].astype(int), axis=2).max() == 0
    holes = np.full((*SIZE, 3), np.nan, np.float32)
    assert np.isfinite(lamps.relit(holes, points, [0])[0]).all()
    for value in (0, 255):
        (made,) = lamps.relit(np.full((*SIZE, 3), value, np.uint8), points, [2])
        assert made.dtype == np.uint8


# What is refused


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda p: [sample("day", p[0].image, p[0].landmarks.points)],
            r"day: the name lacks object and lamp",
        ),
        (lambda p: p[1:], "object head2 has no image under lamp day"),
        (lambda p: p[:1], "object head2 has an image under lamp day only"),
        (lambda p: [p[0], sample("head2-left", p[1].image, p[1].landmarks.points + 20)], "have not moved"),
        (lambda p: [p[0], sample("head2-left", p[1].image[:-9], p[1].landmarks.points)], "differ in size"),
        (lambda p: [p[0], sample("head2-left", p[1].image, p[1].landmarks.points[1:])], "57 to 58 landmarks"),
        (lambda p: [(p[0].image, p[0].landmarks.points)], "liaam.load_folder"),
        (lambda p: [], "no images to learn lamps from"),
    ],
)
def test_pictures_that_tell_no_lamps_are_refused(pictures, change, message):
    with pytest.raises(TrainingError, match=message):
        learn_lamps(change(pictures), "day")


def test_the_light_of_training_has_to_be_told(pictures):
    with pytest.raises(TrainingError, match=r"--training-lamp.* choose from day, left, right"):
        learn_lamps(pictures)
    with pytest.raises(TrainingError, match="no image has the lamp 'night' in its name; choose from day, left, right"):
        learn_lamps(pictures, "night")
    only = [pictures[0], pictures[1], pictures[3], pictures[5]]  # one lamp is common to both heads
    assert learn_lamps(only).names == ("head2-left", "head3-right")


def test_lamps_serve_objects_with_the_same_landmarks(pictures, lamps):
    with pytest.raises(TrainingError, match="with 58 landmarks, but these images have 50"):
        lamps.relit(pictures[0].image, pictures[0].landmarks.points[:50], [0])
    pairs = [(each.image, each.landmarks.points[:50]) for each in pictures[:3]]
    with pytest.raises(TrainingError, match="with 58 landmarks, but the images have 50"):
        train(pairs, diagonal=40.0, lamps=lamps)


def test_a_lamp_file_or_a_name_without_images_is_told(pictures, lamps, tmp_path):
    pairs = [(each.image, each.landmarks.points) for each in pictures[:3]]
    for path in ("heads.lamps", tmp_path / "heads.lamps"):
        with pytest.raises(
            TrainingError, match=r"heads\.lamps': .* for a file give liaam\.training\.load_lamps\(file\)"
        ):
            train(pairs, diagonal=40.0, lamps=path)
    for given in ("auto", None, lamps):
        with pytest.raises(TrainingError, match=r"'day' names the training light in lamp images; give these"):
            train(pairs, diagonal=40.0, lamps=given, training_lamp="day")


# Files


def test_lamps_are_kept_in_a_file(lamps, tmp_path):
    lamps.save(tmp_path / "heads.lamps")
    loaded = load_lamps(tmp_path / "heads.lamps")
    assert loaded.names == lamps.names
    np.testing.assert_array_equal(loaded.fields, lamps.fields)
    np.testing.assert_array_equal(loaded.mean, lamps.mean)


def test_files_without_lamps_are_refused(lamps, tmp_path, trained):
    path, model_file = tmp_path / "heads.lamps", tmp_path / "m.liaam"
    trained[0].save(model_file)
    with pytest.raises(LiaamError, match="does not exist; make one with 'liaam lamps"):
        load_lamps(path)
    with pytest.raises(LiaamError, match="contains no lamps"):
        load_lamps(model_file)
    lamps.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LiaamError, match="not a complete lamp file"):
        load_lamps(path)


def forged(path, tensors: dict[str, np.ndarray], names) -> None:
    from safetensors.numpy import save_file

    about = {"format": "liaam-lamps", "schema": 1, "names": names}
    save_file(tensors, path, {"liaam": json.dumps(about)})


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"fields": np.zeros((1, SIDE, 9, 3), np.float16)}, ["a"]),
        ({"fields": np.full((1, SIDE, SIDE, 3), np.nan, np.float16)}, ["a"]),
        ({"mean": np.full((5, 2), np.nan)}, ["a"]),
        ({"mean": np.zeros((2, 2))}, ["a"]),
        ({}, ["a", "b"]),
        ({}, [1]),
        ({}, "a"),
    ],
)
def test_forged_lamps_are_refused(tmp_path, change, names):
    tensors = {"mean": np.zeros((5, 2)), "fields": np.zeros((1, SIDE, SIDE, 3), np.float16)} | change
    forged(tmp_path / "f.lamps", tensors, names)
    with pytest.raises(LiaamError, match="contradicts itself"):
        load_lamps(tmp_path / "f.lamps")


# Copies


def test_copies_are_as_many_as_asked_for_and_fewer_of_many_pictures(lamps):
    order = np.arange(58)
    assert (Copies.of(lamps, 10, 3, None).counts == 3).all()
    assert not Copies.of(lamps, 10, 0, order).counts.any()
    assert (Copies.of(None, 10, 3, order).counts == 1).all()
    assert not Copies.of(None, 10, 3, None).counts.any()
    some = Copies.of(lamps, 500, 3, None)
    assert (some.counts.sum(), some.counts.min(), some.counts.max()) == (700, 1, 2)
    assert (Copies.of(lamps, 3000, 3, None).counts == 1).all()
    np.testing.assert_array_equal(Copies(lamps, np.array([2, 0, 1])).owners, [0, 0, 0, 1, 2, 2])


def test_halves_of_the_lamps_shine_from_either_side(lamps):
    assert sorted(half.tolist() for half in lamps.halves()) == [[0, 2], [1, 3]]
    shuffled = replace(lamps, fields=lamps.fields[[3, 0, 2]], names=tuple(lamps.names[i] for i in (3, 0, 2)))
    assert sorted(half.tolist() for half in shuffled.halves()) == [[0], [1, 2]]
    single = replace(lamps, fields=lamps.fields[:1], names=lamps.names[:1])
    assert [half.tolist() for half in single.halves()] == [[0]]


def test_copies_know_their_lamps(pictures, lamps):
    day, copied = pictures[0], Copies(lamps, np.array([2, 0, 3]))
    points = day.landmarks.points
    assert copied.lit_by[[0, 3, 4]].tolist() == [-1, -1, -1]
    made = [image for image, _ in copied.of_picture(0, day.image, points, "srgb", 1000.0)]
    by = lamps.relit(day.image, points, copied.lit_by[1:3])
    inside = tuple(np.rint(points[20:40]).astype(int).T[::-1])
    low = np.maximum(np.floor(points.min(axis=0) - 0.5 * diagonal_of(points)), 0).astype(int)
    for copy, whole in zip(made, by, strict=True):
        own = copy[inside[0] - low[1], inside[1] - low[0]].astype(int)
        assert np.abs(own - whole[inside]).mean() < 3
    (chosen,) = copied.relit(1, day.image, points, "srgb", np.array([3]))
    np.testing.assert_array_equal(chosen, lamps.relit(day.image, points, [3])[0])


def test_quality_is_learnt_under_lamps_that_are_left_out_of_training(lamps, left_out_images, monkeypatch):
    """Without this, light that no training image shows makes right fits doubtful."""
    trained_without = left_out._without
    lit_by = Copies(lamps, np.array([4, 4, 4])).lit_by
    known_lamps: dict[int, set[int]] = {}

    def noted(*given, **named):
        part = trained_without(*given, **named)
        rows = signature(trained_without).bind(*given, **named).arguments["under_other_lamps"]
        known_lamps[id(part)] = set(lit_by[rows].tolist())
        return part

    def lamp_of(each) -> int:
        (lamp,) = (i for i in range(4) for day in data if np.array_equal(each.image, relit_by(i, day)))
        return lamp

    def relit_by(lamp: int, day: Sample) -> np.ndarray:
        return lamps.relit(day.image, day.landmarks.points, [lamp])[0]

    monkeypatch.setattr(left_out, "_without", noted)
    data = [sample(f"head{i}-day", s.image, s.landmarks) for i, s in enumerate(make_set(3, Head(5), size=SIZE))]
    train(data, lamps=lamps, diagonal=40.0, blurs=(1.0,), copies=4)
    shown = [(lamp_of(each), known_lamps[id(each.model)]) for each in left_out_images if each.relit]
    left, right = {0, 2}, {1, 3}
    assert {lamp in left for lamp, _ in shown} == {True, False}
    for lamp, known in shown:
        assert known == {-1, *(right if lamp in left else left)}  # -1: the pictures as they are


@pytest.mark.parametrize("offset", [0.0, -10.0, 15.0])
def test_copies_show_the_object_where_their_landmarks_say(pictures, offset):
    """Mirrored and reduced without a lamp, a copy is the picture itself; landmarks keep their offset to the right."""
    day = pictures[0]
    points = day.landmarks.points
    order = mirror_order(render(Head(2), Pose(), size=SIZE).landmarks)
    assert order is not None
    wide = np.repeat(np.repeat(day.image, 5, axis=0), 5, axis=1)
    shifted = 5.0 * points + [2.0 + offset, 2.0]
    copies = replace(Copies.of(None, 1, 1, order), offset=offset)
    ((copy, moved),) = copies.of_picture(0, wide, shifted, "srgb", 60.0)
    assert max(copy.shape) < max(day.image.shape) * 3
    moved = moved - offset * align(shifted, moved).matrix[:, 0]
    pose = align((points * [-1.0, 1.0])[order], moved)
    np.testing.assert_allclose(pose((points * [-1.0, 1.0])[order]), moved, atol=1e-6)
    x, y = np.rint(moved).astype(int).T
    for counterparts, least, most in ((order, 0, 3), (np.arange(len(order)), 6, 255)):
        own = np.rint(points[counterparts]).astype(int)
        assert least <= np.median(np.abs(copy[y, x].astype(float) - day.image[own[:, 1], own[:, 0]])) <= most


def test_an_offset_of_landmarks_stays_on_the_same_side_of_a_mirrored_object():
    image, order, upright = np.zeros((50, 50, 3)), np.array([1, 0, 2]), np.array([[10.0, 10], [30, 10], [20, 40]])
    for points, move in ((upright, 2.0), (upright[:, ::-1], 0.0)):
        plain, moved = (mirrored(image, points, order, offset)[1] for offset in (0.0, 1.0))
        np.testing.assert_allclose(moved - plain, np.tile([move, 0.0], (3, 1)), atol=1e-9)


# Models


@pytest.fixture(scope="module")
def trained(lamps):
    """Models of one head in daylight, without and with the lamps of two others."""
    shown = [(scene.image, scene.landmarks) for scene in make_set(8, Head(5), size=SIZE)]
    options = {"diagonal": 60.0, "leave_out": False, "methods": ["li"]}
    return [train(shown, lamps=own, copies=n, **options) for own, n in ((None, 0), (lamps, 3))]


@pytest.mark.slow
def test_a_model_that_has_learnt_the_light_fits_better_under_it(trained):
    errors = []
    for model in trained:
        fitter, own = Fitter(model), []
        for seed in range(20, 26):
            for picture in photographed(5, seed)[1:]:
                truth = picture.landmarks.points
                own.append(point_error(fitter.fit(picture.image, disturb(truth)).landmarks, truth))
        errors.append(np.mean(own))
    assert errors[1] < 0.9 * errors[0]


def test_a_model_knows_how_many_copies_it_has_learnt_from(trained, tmp_path):
    plain, lit = trained
    assert (plain.n_images, plain.n_textures, lit.n_textures) == (8, 8, 32)
    lit.save(tmp_path / "m.liaam")
    loaded = load_model(tmp_path / "m.liaam")
    assert loaded.n_textures == 32
    modes = lit.views["surroundings"].levels[-1].appearances["soft"].n_modes
    assert loaded.views["surroundings"].levels[-1].appearances["soft"].n_modes == modes
    for ours, theirs in zip(plain.levels, lit.levels, strict=True):
        np.testing.assert_array_equal(ours.appearances["log"].mean, theirs.appearances["log"].mean)


def test_copies_out_of_range_are_refused(pictures):
    with pytest.raises(TrainingError, match="copies 21: give 0 to 20"):
        train(pictures, diagonal=40.0, copies=21)


# The command line


@pytest.fixture
def folder(pictures, tmp_path):
    path = tmp_path / "lamps"
    path.mkdir()
    for each in pictures:
        write_image(path / f"{each.name}.png", each.image)
        write_landmarks(path / f"{each.name}.pts", each.landmarks.points)
    return path


def test_lamps_are_made_drawn_and_trained_with(run, folder, tmp_path):
    file = tmp_path / "heads.lamps"
    code, out, _ = run("lamps", folder, "-o", file, "--training-lamp", "day")
    assert code == 0
    assert "4 lamps for objects with 58 landmarks" in out
    assert not list(tmp_path.glob("*.png"))  # nothing is written that was not asked for
    code, out, _ = run("show", file, "--image", folder / "head2-day.png", "-o", tmp_path / "one.png")
    assert code == 0 and (tmp_path / "one.png").stat().st_size > 1000
    options = ("--diagonal", 40, "--no-leave-out")
    code, out, _ = run(
        "train", folder / "*-[dl][ae]*", "-o", tmp_path / "m.liaam", *options, "--lamps", file, "--copies", 2
    )
    assert code == 0
    assert "4 images and 8 copies in other light (4 lamps)" in out


def test_slips_are_told(run, folder, tmp_path):
    assert "ends in .lamps" in run("lamps", folder, "-o", tmp_path / "heads.png")[2]
    assert "--training-lamp" in run("lamps", folder, "-o", tmp_path / "heads.lamps")[2]
    assert "--image works with lamp" in run("show", tmp_path / "m.liaam", "--image", folder / "head2-day.png")[2]
    code, _, err = run("train", folder, "-o", tmp_path / "m.liaam", "--lamps", tmp_path / "none.lamps")
    assert (code, "does not exist; give a lamp file, a folder, 'auto' or 'none'" in err) == (1, True)


# The light basis of a model


def test_a_basis_holds_the_lamps_it_was_learnt_from(lamps):
    basis = lamps.basis(mirrored=False)
    near = _away_from(lamps.mean) < SHARP
    modes = basis.modes.astype(np.float32)[:, near].reshape(len(basis.modes), -1)
    fields = GAMMA * lamps.fields.astype(np.float32)[:, near].reshape(len(lamps), -1)
    left = fields - np.linalg.lstsq(modes.T, fields.T, rcond=None)[0].T @ modes
    assert np.square(left).mean() < 0.3 * np.square(fields).mean()
    assert not basis.modes[:, _away_from(lamps.mean) > FADED].any()


def test_a_basis_of_symmetric_objects_knows_the_mirrored_lamps(lamps):
    basis = lamps.basis(mirrored=True).modes.astype(np.float32)[:-2]
    energy, mirrored = (np.square(fields).sum(axis=0) for fields in (basis, basis[:, :, ::-1]))
    near = _away_from(lamps.mean) < SHARP / 2
    near &= near[:, ::-1]
    assert np.abs(energy - mirrored)[near].mean() < 0.05 * energy[near].mean()


@pytest.mark.parametrize("alike", [True, False])
def test_the_remainder_is_what_the_lamps_of_other_objects_do_not_explain(lamps, alike):
    """A bank of a few lamps explains itself well, but not an object that it has not seen."""
    fields = np.zeros((2, SIDE, SIDE, 3), np.float16)
    fields[0, :, : SIDE // 2] = 1.0
    fields[1, :, slice(0, SIDE // 2) if alike else slice(SIDE // 2, SIDE)] = 1.0
    basis = LearntLamps(lamps.mean, fields, ("a-left", "b-left")).basis(mirrored=False)
    inside = _away_from(lamps.mean) <= 0
    expected = 0.0 if alike else GAMMA / np.sqrt(2.0)
    assert np.median(basis.remainder[inside]) == pytest.approx(expected, abs=0.05)


def test_a_single_lamp_leaves_all_of_its_change_unexplained(lamps):
    basis = LearntLamps(lamps.mean, np.full((1, SIDE, SIDE, 3), -0.5, np.float16), ("a-left",)).basis(mirrored=False)
    assert np.median(basis.remainder[_away_from(lamps.mean) <= 0]) == pytest.approx(0.5 * GAMMA, abs=0.01)


def test_models_without_lamps_have_no_light(trained, tmp_path):
    plain, lit = trained
    assert plain.light is None
    lit.save(tmp_path / "lit.liaam")
    loaded = load_model(tmp_path / "lit.liaam").light
    for field in ("mean", "modes", "remainder"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(lit.light, field))


@pytest.mark.parametrize(
    "changes",
    [
        {"mean": np.zeros((68, 2))},
        {"remainder": np.full((SIDE, SIDE), -1, np.float16)},
        {"modes": np.zeros((2, SIDE, 5, 3), np.float16)},
        {"modes": np.full((2, SIDE, SIDE, 3), np.nan, np.float16)},
    ],
)
def test_a_damaged_light_basis_is_refused(trained, tmp_path, changes):
    lit = trained[1]
    replace(lit, light=replace(lit.light, **changes)).save(tmp_path / "bad.liaam")
    with pytest.raises(ModelFileError, match="contradicts itself"):
        load_model(tmp_path / "bad.liaam")


def test_relighting_with_lamps_reaches_beyond_the_mesh(trained):
    import cv2

    errors = {}
    pose, expression = random_pose(np.random.default_rng(4), SIZE), random_expression(np.random.default_rng(4))
    dark, day = (render(Head(5), pose, expression, light, size=SIZE) for light in (lateral("left"), DIFFUSE))
    truth = np.log((day.image + 8.0) / 255)
    for name, model in zip(("plain", "lit"), trained, strict=True):
        fitter = Fitter(model)
        relighter = Relighter.of(fitter, dark.image, fitter.fit(dark.image, day.landmarks))
        assert relighter.log_flat.dtype == relighter.log_own.dtype == np.float32
        covered = np.zeros(truth.shape[:2], bool)
        covered[relighter.region.box] = relighter.covered
        away = cv2.distanceTransform((~covered).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        around = (away > 6) & (away < 20)
        errors[name] = root_mean_square((np.log((relighter.flat() + 8.0) / 255) - truth)[around])
    assert errors["lit"] < 0.85 * errors["plain"]


def test_the_light_of_another_image_is_put_on_its_surroundings_too(trained):
    fitter, pictures = Fitter(trained[1]), {}
    for name, light in (("left", lateral("left")), ("day", DIFFUSE)):
        scene = render(Head(5), Pose(), random_expression(np.random.default_rng(4)), light, size=SIZE)
        pictures[name] = Relighter.of(fitter, scene.image, fitter.fit(scene.image, scene.landmarks))
    day, left = pictures["day"], pictures["left"]
    assert root_mean_square(day.like(day).astype(float) - day.picture) < 4.0
    assert day.like(left).mean() < day.flat().mean()
