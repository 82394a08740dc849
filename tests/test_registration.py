"""Registration by a homography, whatever the light: on planes with known truth, and on real objects."""

from dataclasses import replace

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.errors import ImageError, MethodError
from liaam.fitting import FitStatus, get_method
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.io import read_image
from liaam.model.shape import align
from liaam.model.warp import apply_homography
from liaam.photometry import THETA_DEFAULT
from liaam.registration import OPTIONS, _levels, register, warp_picture
from scenes import Camera, narrow_band_camera, photograph, poster, uneven_light

SIZE, SMALL = (160, 200), (120, 150)


def corners_of(size):
    height, width = size
    return np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=np.float64)


def random_homography(rng, size, reach=8.0):
    import cv2

    corners = corners_of(size).astype(np.float32)
    moved = corners + rng.uniform(-reach, reach, (4, 2)).astype(np.float32)
    return cv2.getPerspectiveTransform(corners, moved)


def plane(seed, camera, size=SIZE):
    """Two pictures of one poster under different lights, and the homography between them."""
    rng = np.random.default_rng([seed, 77])
    homography = random_homography(rng, size)
    lights = [uneven_light(size, 2 * seed + i, lamp_K=float(rng.uniform(2800, 6500))) for i in (0, 1)]
    sheet = poster(size, seed)
    a, b = (
        photograph(sheet, light, camera, seed=seed + i, homography=h)
        for i, (light, h) in enumerate(zip(lights, (None, homography), strict=True))
    )
    return a, b, homography


def corner_error(found, truth, corners):
    there, wanted = apply_homography(found.homography, corners), apply_homography(truth, corners)
    return float(np.nan_to_num(np.linalg.norm(there - wanted, axis=1), nan=1e3).mean())


@pytest.mark.parametrize(
    "camera", [replace(narrow_band_camera(response="srgb"), bits=8), Camera()], ids=["lines", "broad"]
)
def test_planes_under_other_lights_are_aligned(camera):
    errors = []
    for seed in (0, 2):
        a, b, truth = plane(seed, camera)
        found = register(a, b)
        assert found.status is FitStatus.CONVERGED, seed
        errors.append(corner_error(found, truth, corners_of(SIZE)))
    assert max(errors) < 0.5
    assert np.median(errors) < 0.1


@pytest.mark.slow
def test_the_invariant_with_its_angle_inside_aligns_where_grey_values_do_not():
    errors = {"li": [], "grey": []}
    for seed in range(5):
        a, b, truth = plane(seed, replace(narrow_band_camera(response="srgb"), bits=8))
        for method in errors:
            errors[method].append(corner_error(register(a, b, method), truth, corners_of(SIZE)))
    assert np.median(errors["li"]) < 0.5 < np.median(errors["grey"])


def test_the_angle_is_found_along_with_the_homography():
    camera = replace(narrow_band_camera(response="srgb"), bits=8)
    a, b, _ = plane(1, camera)
    found = register(a, b, "li", theta=camera.theta("wien"))
    assert abs(found.theta - camera.theta("wien")) < np.deg2rad(2.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cat", "owl", "rock"])
def test_real_objects_under_other_directions_of_light_are_aligned(shared_data, name):
    import cv2

    folder = shared_data / "light-directions" / name
    y, x = np.nonzero(read_image(folder / f"{name}.mask.png")[..., 0] > 127)
    box = np.array([[x.min(), y.min()], [x.max(), y.min()], [x.max(), y.max()], [x.min(), y.max()]], dtype=np.float64)
    errors = []
    for seed in range(3):
        rng = np.random.default_rng([seed, 5])
        i, j = rng.choice(12, 2, replace=False)
        a, b = (read_image(folder / f"{name}.{k}.png") for k in (i, j))
        truth = random_homography(rng, a.shape[:2])
        moved = cv2.warpPerspective(b, truth, a.shape[1::-1], flags=cv2.INTER_CUBIC)
        # At the corners of the object's box: the rest of the picture is black.
        errors.append(corner_error(register(a, moved, response="linear"), truth, box))
    assert np.median(errors) < 0.5
    assert max(errors) < 1.2


@pytest.mark.parametrize("group", ["translation", "similarity", "affine"])
def test_a_smaller_group_of_warps_stays_within_it(group):
    a, _, _ = plane(2, Camera(), SMALL)
    b = np.roll(a, (2, -3), axis=(0, 1))
    found = register(a, b, group=group)
    assert found.status.ok
    np.testing.assert_allclose(found.homography, [[1, 0, -3], [0, 1, 2], [0, 0, 1]], atol=0.05)
    if group == "translation":
        np.testing.assert_allclose(found.homography[:2, :2], np.eye(2), atol=1e-9)


@pytest.mark.slow
def test_large_pictures_are_reduced_and_still_aligned():
    size = (600, 800)
    a, b, truth = plane(3, Camera(), size)
    assert corner_error(register(a, b), truth, corners_of(size)) < 0.5


def test_a_start_makes_up_for_a_large_movement():
    a, _, _ = plane(2, Camera())
    b = np.roll(a, 50, axis=1)
    start = np.array([[1, 0, 48.0], [0, 1, 1.0], [0, 0, 1]])
    found = register(a, b, init=start)
    assert found.status.ok
    assert corner_error(found, np.array([[1, 0, 50.0], [0, 1, 0], [0, 0, 1]]), corners_of(SIZE)) < 0.2


def test_the_second_picture_is_brought_into_the_frame_of_the_first():
    a, b, _ = plane(4, replace(narrow_band_camera(), bits=None))
    same = photograph(poster(SIZE, 4), uneven_light(SIZE, 9), narrow_band_camera())
    sampled, mask = register(a, b).warp(b)
    assert sampled.shape == same.shape and sampled.dtype == b.dtype
    assert mask.dtype == bool and 0.8 < mask.mean() <= 1


@pytest.mark.slow
def test_errors_of_corners_are_of_the_size_that_is_stated():
    ratios = []
    for seed in range(6):
        a, b, truth = plane(seed, Camera())
        found = register(a, b)
        there, wanted = (apply_homography(h, corners_of(SIZE)) for h in (found.homography, truth))
        ratios.append(np.linalg.norm(there - wanted, axis=1) / found.corner_deviation)
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 4.0


def test_pictures_of_different_things_are_told():
    a, _, _ = plane(1, Camera(), SMALL)
    _, b, _ = plane(7, Camera(), SMALL)
    found = register(a, b)
    assert found.status is FitStatus.DIVERGED
    assert "they show different things" in found.message
    assert found.correlation < 0.3  # 0.77 for two pictures of the same


@pytest.mark.parametrize("value", [0, 128, 255])
@pytest.mark.parametrize("method", ["igo+tukey", "grey", "li"])
def test_flat_pictures_have_nothing_to_register_by(value, method):
    flat = np.full((*SMALL, 3), value, np.uint8)
    flat[..., 0] = max(value - 1, 0) if value else 1
    found = register(flat, flat, method)
    assert found.status in (FitStatus.NO_TEXTURE, FitStatus.TOO_DARK)
    assert np.isfinite(found.homography).all() and found.message


def test_pictures_with_nan_and_other_types_are_taken():
    a, b, truth = plane(5, replace(Camera(), bits=16))
    floats = (b / 65535).astype(np.float32)
    floats[20:30, 20:30] = np.nan
    assert corner_error(register(a, floats), truth, corners_of(SIZE)) < 0.3


@pytest.mark.parametrize(
    ("options", "error", "fault"),
    [
        ({"method": "nonsense"}, MethodError, "nonsense"),
        ({"method": "soft-li"}, MethodError, "soft-li needs a trained model, not a second image; use li, igo or grey"),
        ({"group": "rubber"}, MethodError, "homography"),
        ({"mask": np.ones((3, 3), bool)}, ImageError, "mask is 3×3"),
        ({"init": np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 1.0]])}, ImageError, "behind"),
        ({"method": "li"}, ImageError, "grey"),
    ],
)
def test_mistakes_are_named(options, error, fault):
    a, _, _ = plane(1, Camera(), SMALL)
    b = np.repeat(a[..., :1], 3, axis=2) if options.get("method") == "li" else a
    with pytest.raises(error, match=fault):
        register(a, b, **options)


@pytest.mark.parametrize("method", ["li-pcs", "rgb+tukey", "igo", "li+noise+huber"])
def test_columns_are_the_derivative_of_the_residual(method, rng):
    a, b, _ = plane(1, Camera(), SMALL)
    mask = np.arange(SMALL[1]) + np.zeros((SMALL[0], 1)) > 20
    objective = _levels(a, get_method(method), "homography", "srgb", THETA_DEFAULT, mask)[0][-1]
    warp, n_p = objective.warp, objective.warp.n_parameters
    pose = align(warp.rest, warp.rest)
    image = EncodedImage.at(b, warp.rest, pose, objective.method, "srgb", objective.blur)
    state = objective.start(rng.normal(0, 0.5, n_p))._replace(angles=np.array([2.0, 2.2]))
    problem = objective.problem(image)
    problem.begin(*state)
    problem.evaluate(False)
    for _ in range(2):
        problem.reweigh(False)
    problem.differentiate(True, True)
    root = problem.masked.ravel()
    by_warp = root[:, None] * problem.by_parameters(problem.gradients)
    by_angles = (root * problem.columns).T

    def residual(p: np.ndarray, turn: np.ndarray) -> np.ndarray:
        problem.set_state(p, state.angles + objective.method.angle_directions @ turn, state.lam)
        problem.evaluate(False)
        return (problem.masked * problem.residual).ravel()

    def in_one_cell(low, high):
        same = [np.floor(image.from_model(warp.points(p))) for p in (low, high)]
        return np.repeat((same[0] == same[1]).all(axis=1), objective.method.n_rows)

    # A step no pixel makes more than 0.04 pixels of: samples are smooth between pixel lines only.
    steps = 0.04 / np.abs(warp.jacobian(state.p)).max(axis=(0, 1))
    no_turn = np.zeros(objective.n_q - n_p)
    assert_jacobian(lambda p: residual(p, no_turn), by_warp, state.p, steps=steps, tolerance=2e-3, valid=in_one_cell)
    if objective.n_q > n_p:
        assert_jacobian(lambda t: residual(state.p, t), by_angles, no_turn, steps=1e-2, tolerance=2e-3)


@pytest.mark.parametrize(("method", "gain"), [("igo", 5.0), ("li", 3.0)])
def test_scoring_takes_away_the_pull_of_noise_towards_the_middle_between_pixels(method, gain):
    """Pictures that lie still: noise sampled between pixels is smoother, so a plain minimum lies off."""
    pull = {0: [], 20: []}
    for seed in range(3):
        sheet, camera = poster(SIZE, seed), Camera(read_noise=0.01)
        a, b = (photograph(sheet, uneven_light(SIZE, 2 * seed + i), camera, seed=2 * seed + i) for i in (0, 1))
        for scoring, shifts in pull.items():
            found = register(a, b, method, group="translation", options=replace(OPTIONS, scoring=scoring))
            shifts.append(np.abs(found.homography[:2, 2]))
    assert np.mean(pull[20]) < 0.08
    assert np.mean(pull[0]) > gain * np.mean(pull[20])


def test_each_picture_may_have_a_white_balance_of_its_own():
    a, b, truth = plane(0, replace(Camera(), bits=None))
    balanced = (b * np.array([1.1, 0.9, 0.8])).astype(np.float32)
    assert corner_error(register(a, balanced, "li"), truth, corners_of(SIZE)) < 0.2


def test_a_mask_keeps_out_what_moved_by_itself():
    a, b, truth = plane(6, Camera())
    moving = np.zeros(SIZE, bool)
    moving[30:130, 40:150] = True
    b = b.copy()
    b[moving] = np.roll(b, 5, axis=1)[moving]
    kept = register(a, b, "li", mask=~moving)
    assert kept.status.ok
    assert (
        corner_error(kept, truth, corners_of(SIZE)) < 0.3 < corner_error(register(a, b, "li"), truth, corners_of(SIZE))
    )


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_pictures_of_other_sizes_start_whole_on_whole(factor):
    import cv2

    a, b, truth = plane(3, Camera())
    b = cv2.resize(b, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    shift = (factor - 1) / 2
    truth = np.array([[factor, 0, shift], [0, factor, shift], [0, 0, 1]]) @ truth
    assert corner_error(register(a, b), truth, corners_of(SIZE)) < 0.3


def test_a_tenth_of_the_picture_is_within_reach():
    for seed in range(2):
        rng = np.random.default_rng([seed, 5])
        truth, sheet = random_homography(rng, SIZE, reach=16.0), poster(SIZE, seed)
        a = photograph(sheet, uneven_light(SIZE, 2 * seed), seed=seed)
        b = photograph(sheet, uneven_light(SIZE, 2 * seed + 1), seed=seed + 9, homography=truth)
        found = register(a, b)
        assert found.status.ok
        assert corner_error(found, truth, corners_of(SIZE)) < 0.5


@pytest.mark.parametrize("size", [(8, 8), (20, 16), (64, 48)])
def test_small_pictures_are_aligned_or_refused(size):
    import cv2

    a = cv2.resize(plane(4, Camera())[0], size[::-1], interpolation=cv2.INTER_AREA)
    found = register(a, np.roll(a, 1, axis=1))
    assert np.isfinite(found.homography).all()
    if found.status.ok:
        np.testing.assert_allclose(found.homography[:2, 2], [1, 0], atol=0.1)
    assert found.status.ok == (min(size) > 8)


@pytest.mark.parametrize("axis", [0, 1])
def test_pictures_longer_than_opencv_can_warp_are_warped_by_parts(rng, axis):
    """What lies far beyond the end of a picture makes no difference, and a horizon in it is no error."""
    homography = np.array([[1.2, 0.01, -3.0], [0.02, 0.9, 4.0], [1e-5, 2e-6, 1.0]])
    picture, size = rng.integers(0, 256, (30, 33_000, 3), dtype=np.uint8), (40, 31_000)
    swap = np.eye(3)[[1, 0, 2]] if axis == 0 else np.eye(3)

    def warped(part, to_part, wanted):
        if axis:
            return warp_picture(part, to_part, wanted)
        turned = warp_picture(np.ascontiguousarray(part.swapaxes(0, 1)), swap @ to_part @ swap, wanted[::-1])
        return turned.swapaxes(0, 1)

    whole, cut = (warped(each, homography, size)[:, :20_000] for each in (picture, picture[:, :32_000]))
    assert np.abs(whole.astype(int) - cut).max() <= 8  # positions are rounded to 1/32 pixel
    assert whole.any()
    with_horizon = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1 / 20_000, 0.0, -1.0]])
    assert warped(picture, with_horizon, (40, 40_000)).shape == (40, 40_000, 3)
