"""The scene simulator obeys the image formation that it claims, and its ground truth is true."""

import itertools
import sys
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from liaam.errors import LiaamError
from scenes import (
    DIFFUSE,
    Ambient,
    Camera,
    Expression,
    Head,
    PointLight,
    Pose,
    lateral,
    make_set,
    narrow_band_camera,
    render,
)
from scenes.chart import CONTOURS
from scenes.render import landmarks_of

SMALL = (160, 120)


@pytest.fixture(autouse=True)
def rendered_anew(monkeypatch):
    """Render the pictures of sets here, too, instead of taking those of another test."""
    monkeypatch.setattr(sys.modules["scenes.render"], "render", render)


SKY = (Ambient(),)
"""Light where it does not matter: it casts no shadows, which take longest to render."""


@lru_cache
def small_scene(lights=DIFFUSE, camera=None, mixing="additive"):
    """One head under some lights."""
    return render(Head(1), lights=lights, camera=camera, size=SMALL, mixing=mixing)


def invariant(rgb: np.ndarray, theta: float) -> np.ndarray:
    """L(theta) . log rho, written here once more so that the test does not lean on the library."""
    axis = np.array([np.cos(theta), np.sin(theta), -np.cos(theta) - np.sin(theta)])
    return np.log(rgb.astype(float)) @ axis


def iod(landmarks: np.ndarray) -> float:
    return float(np.linalg.norm(landmarks[13:21].mean(0) - landmarks[21:29].mean(0)))


# Light

LIGHTS = (
    DIFFUSE,
    lateral("left"),
    lateral("right", temperature_K=2800, ambient_temperature_K=12000, strength=3.0),
    (PointLight((0.2, 1, 0.6), 4200, 0.7), PointLight((-1, 0, 0.5), 9000, 0.5), Ambient(3000, 0.1)),
)


@pytest.mark.parametrize("lights", LIGHTS[2:], ids=["right", "three"])
def test_the_invariant_does_not_move_with_the_light(lights):
    camera = narrow_band_camera()
    first, second = (small_scene(light, camera, "planckian") for light in (DIFFUSE, lights))
    unsaturated = ((first.image < 1) & (second.image < 1)).all(-1)
    assert unsaturated[first.mask].mean() > 0.9
    a, b = invariant(first.image, first.theta), invariant(second.image, second.theta)
    np.testing.assert_allclose(a[unsaturated], b[unsaturated], atol=1e-5)
    assert np.ptp(np.log(second.image[unsaturated] / first.image[unsaturated])) > 1  # the light did change


def test_additive_mixing_leaves_the_invariant_nearly_alone():
    camera = narrow_band_camera()
    first, second = (small_scene(light, camera) for light in (DIFFUSE, lateral()))
    change = np.abs(invariant(first.linear, first.theta) - invariant(second.linear, first.theta))[first.mask]
    assert 1e-5 < change.max() < 0.03


def test_lights_of_one_temperature_make_both_mixings_the_same():
    lights = (PointLight((1, 0, 1), 4000, 1), Ambient(4000, 0.3))
    additive, planckian = (small_scene(lights, mixing=mixing).linear for mixing in ("additive", "planckian"))
    np.testing.assert_allclose(additive, planckian, rtol=1e-4)


@pytest.mark.parametrize("peaks", [(610, 540, 450), (600, 550, 440), (650, 520, 470)])
def test_theta_of_line_sensors_is_that_of_the_closed_form(peaks):
    r, g, b = peaks
    closed = 90 + np.degrees(np.arctan2(1 / b - 1 / g, 1 / b - 1 / r))
    assert np.degrees(narrow_band_camera(peaks).theta("wien")) == pytest.approx(closed, abs=0.1)


@pytest.mark.parametrize("radiator", ["wien", "planck"])
def test_theta_is_orthogonal_to_the_shift_of_temperature(radiator):
    camera = Camera()
    warm, cold = (np.log(camera.matrix(1e6 / kelvin, radiator).sum(-1)) for kelvin in (4000, 6500))
    assert invariant(np.exp(cold - warm)[None], camera.theta(radiator)) == pytest.approx(0, abs=1e-9)
    assert 90 < np.degrees(camera.theta(radiator)) < 135


def test_wien_and_planck_agree_in_warm_light():
    camera = Camera()
    np.testing.assert_allclose(camera.matrix(1e6 / 3000, "wien"), camera.matrix(1e6 / 3000, "planck"), rtol=5e-3)


def test_the_reflectance_does_not_depend_on_the_light():
    np.testing.assert_array_equal(small_scene().reflectance, small_scene(lateral("left")).reflectance)


def test_white_light_shows_reflectance_times_shading():
    camera = Camera(exposure=1.0, vignetting=0.0)
    scene = render(
        Head(1), lights=(Ambient(camera.white_K, 0.7), PointLight((1, 1, 1), camera.white_K)), camera=camera, size=SMALL
    )
    np.testing.assert_allclose(scene.linear, scene.reflectance * scene.shading[..., None], rtol=1e-4)


@pytest.mark.parametrize("side", ["left", "right"])
def test_lateral_light_casts_a_shadow_on_the_far_side(side):
    scene = small_scene(lateral(side))
    x = np.arange(SMALL[1])[None] - scene.landmarks[:, 0].mean()
    far = scene.mask & ((x > 5) if side == "left" else (x < -5))
    near = scene.mask & ((x < -5) if side == "left" else (x > 5))
    assert 0.1 < scene.shadow[scene.mask].mean() < 0.7
    assert scene.shadow[far].mean() > 2 * scene.shadow[near].mean()
    assert scene.linear[far].mean() < 0.6 * scene.linear[near].mean()


def test_the_nose_casts_its_shadow_on_a_surface_that_faces_the_lamp():
    lamp = lateral("left", ambient_strength=0.0)[:1]
    scene = render(Head(1), lights=lamp)
    x, y = np.round(scene.landmarks[55]).astype(int)  # the wing of the nose that the lamp does not see
    cheek = scene.shadow[y - 14 : y, x + 2 : x + 12]
    assert cheek.max() > 0.95


def test_diffuse_light_has_no_hard_shadow_on_the_cheeks():
    scene = small_scene()
    assert scene.shading[scene.mask].min() > 0.15
    assert np.percentile(scene.shading[scene.mask], 10) > 0.5


# Geometry


def points_of(head, pose=Pose(), expression=Expression()):  # noqa: B008 (frozen)
    return landmarks_of(head, pose, expression, SMALL)


def test_shift_and_scale_move_the_landmarks_as_they_say():
    still = points_of(Head(1))
    moved = points_of(Head(1), Pose(x=3.25, y=-2.5))
    np.testing.assert_allclose(moved - still, np.broadcast_to([3.25, -2.5], still.shape), atol=1e-9)
    larger = points_of(Head(1), Pose(scale=1.1))
    assert iod(larger) / iod(still) == pytest.approx(1.1, abs=1e-6)


def test_roll_turns_the_landmarks_by_its_angle():
    still, rolled = (points_of(Head(1), Pose(roll=roll)) for roll in (0.0, 0.2))
    eyes = rolled[13:21].mean(0) - rolled[21:29].mean(0)
    assert np.arctan2(eyes[1], eyes[0]) == pytest.approx(0.2, abs=0.01)  # clockwise: y points down
    assert iod(rolled) == pytest.approx(iod(still), rel=0.01)


def test_yaw_and_pitch_move_the_tip_of_the_nose_most():
    still = points_of(Head(1))
    right, up = (points_of(Head(1), pose) for pose in (Pose(yaw=0.2), Pose(pitch=0.15)))
    jaw_ends, nose = [0, 12], 52
    assert (right - still)[nose, 0] > (right - still)[jaw_ends, 0].mean() + 3
    assert (up - still)[nose, 1] < (up - still)[jaw_ends, 1].mean() - 1


@pytest.mark.parametrize(
    ("pose", "expression"),
    [
        (Pose(yaw=0.15, roll=-0.1, scale=0.95), Expression()),
        (Pose(pitch=-0.1, x=7.3), Expression(smile=0.7, mouth_open=0.3)),
    ],
)
def test_landmarks_stay_on_the_same_points_of_the_skin(pose, expression):
    """Patches of reflectance warped by the landmarks themselves agree between two pictures."""
    first, second = render_large(), render_large(pose, expression)
    inner = [0, 1, 2, 14, 18, 22, 26, 31, 36, 39, 43, 52]
    colours = [np.log(_sample(s.reflectance, s.landmarks[inner])) for s in (first, second)]
    change = np.abs(colours[0] - colours[1]).mean(axis=1)
    assert np.median(change) < 0.10
    # ... which chance would not do: the same places of the first picture's pixels disagree more.
    wrong = np.abs(colours[0] - np.log(_sample(second.reflectance, first.landmarks[inner]))).mean(axis=1)
    assert change.mean() < wrong.mean()


@lru_cache
def render_large(pose=Pose(), expression=Expression()):  # noqa: B008 (frozen)
    return render(Head(1), pose, expression, SKY)


def _sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    x, y = np.round(points).astype(int).T
    return np.stack([image[j - 1 : j + 2, i - 1 : i + 2].mean(axis=(0, 1)) for i, j in zip(x, y, strict=True)])


def test_a_wink_an_open_mouth_and_a_smile_move_the_right_landmarks():
    still, opened, smiling, closed, raised = (
        points_of(Head(1), expression=e)
        for e in (
            Expression(),
            Expression(mouth_open=1),
            Expression(smile=1),
            Expression(eye_close=1),
            Expression(brow_raise=1),
        )
    )
    height = lambda p, top, bottom: p[bottom, 1] - p[top, 1]  # noqa: E731
    assert height(opened, 41, 45) > height(still, 41, 45) + 5
    assert opened[6, 1] > still[6, 1] + 4  # the chin drops
    assert smiling[43, 0] - smiling[39, 0] > still[43, 0] - still[39, 0] + 3
    assert smiling[39, 1] < still[39, 1] - 2
    assert height(closed, 15, 19) < 0.15 * height(still, 15, 19)
    assert raised[31, 1] < still[31, 1] - 2


def test_a_neutral_face_is_symmetric():
    points = points_of(Head(6))
    mirror = np.r_[12:-1:-1, 21:29, 13:21, 34:39, 29:34, 43:38:-1, 46:43:-1, 57:46:-1]
    np.testing.assert_allclose(points[mirror] * [-1, 1] + [SMALL[1] - 1, 0], points, atol=1e-6)


def test_contours_visit_every_landmark_once():
    indices = list(itertools.chain.from_iterable(line for line, _ in CONTOURS))
    assert sorted(indices) == list(range(58))


def test_the_mask_is_the_hull_of_the_landmarks():
    scene = small_scene()
    np.testing.assert_array_equal(scene.landmarks, landmarks_of(Head(1), Pose(), Expression(), scene.image.shape[:2]))
    inside = np.round(scene.landmarks.mean(axis=0)).astype(int)
    assert scene.mask[inside[1], inside[0]]
    assert not scene.mask[0].any()
    assert 0.1 < scene.mask.mean() < 0.4


# Camera


def test_the_noise_has_the_stated_variance(rng):
    camera = Camera(shot_noise=4e-4, read_noise=3e-3, response="linear", bits=None)
    for level in (0.05, 0.3, 0.7):
        values = camera.expose(np.full((200, 200, 3), level), rng)
        assert values.var() == pytest.approx(4e-4 * level + 9e-6, rel=0.03)


@pytest.mark.parametrize("response", ["srgb", "linear", 2.2])
def test_the_response_is_inverted(response, rng):
    camera, values = Camera(response=response), rng.random(1000)
    np.testing.assert_allclose(camera.decode(camera.encode(values)), values, atol=1e-6)


@pytest.mark.parametrize(("bits", "dtype", "top"), [(8, np.uint8, 255), (16, np.uint16, 65535), (None, np.float32, 1)])
def test_bits_set_type_and_range(bits, dtype, top, rng):
    camera, linear = Camera(bits=bits, read_noise=0, shot_noise=0), rng.random((20, 30, 3))
    image = camera.expose(linear, rng)
    assert image.dtype == dtype
    step = 0.51 if bits else 1e-6
    np.testing.assert_allclose(image, camera.encode(linear) * top, atol=step)


def test_the_automatic_exposure_spares_the_face():
    for lights in (DIFFUSE, lateral("left"), lateral("right", temperature_K=3000)):
        scene = small_scene(lights)
        face = scene.image[scene.mask]
        assert (face.max(axis=-1) > 250).mean() < 0.02
        assert (face.min(axis=-1) < 8).mean() < 0.03
        assert np.percentile(scene.linear[scene.mask].max(-1), 98) == pytest.approx(0.8, abs=0.02)


def test_a_fixed_exposure_scales_the_linear_image():
    one, two = (small_scene(SKY, Camera(exposure=e)).linear for e in (0.5, 1.0))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-5)


# Sets and seeds


def test_the_same_seeds_give_the_same_picture():
    first, second = small_scene(lateral()), render(Head(1), lights=lateral(), size=SMALL)
    np.testing.assert_array_equal(first.image, second.image)


def test_seeds_change_the_noise_and_identities_the_person():
    first = small_scene(SKY)
    second, other = (render(head, lights=SKY, size=SMALL, seed=1) for head in (Head(1), Head(6)))
    np.testing.assert_array_equal(first.linear, second.linear)
    assert np.any(first.image != second.image)
    assert np.abs(first.linear - other.linear).mean() > 0.01
    assert np.abs(first.landmarks - other.landmarks).max() > 0.5


def test_a_longer_set_begins_with_the_shorter():
    short, long = (make_set(n, Head(1), SKY, size=SMALL, seed=4) for n in (1, 2))
    for a, b in zip(short, long, strict=False):
        np.testing.assert_array_equal(a.image, b.image)
    shapes = np.stack([s.landmarks for s in long])
    assert np.ptp(shapes, axis=0).max() > 2


def test_a_given_trait_overrides_the_drawn_one():
    fair, deep = (render(Head(1, skin=tone), lights=SKY, size=SMALL) for tone in (0.0, 1.0))
    assert fair.reflectance[fair.mask].mean() > 2 * deep.reflectance[deep.mask].mean()


# Robustness


@settings(max_examples=6, deadline=None)
@given(
    seed=st.sampled_from([1, 6]),
    angles=st.tuples(*[st.floats(-0.26, 0.26)] * 3),
    scale=st.floats(0.8, 1.05),
    face=st.tuples(st.floats(0, 1), st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 1), st.floats(0, 1)),
    side=st.sampled_from(["left", "right", None]),
)
def test_every_pose_and_expression_gives_a_sound_scene(seed, angles, scale, face, side):
    lights = lateral(side) if side else DIFFUSE
    scene = render(Head(seed), Pose(*angles, scale=scale), Expression(*face), lights, size=SMALL, seed=seed)
    for name in ("image", "linear", "landmarks", "reflectance", "shading", "shadow"):
        assert np.isfinite(getattr(scene, name)).all(), name
    assert (scene.landmarks >= 0).all()
    assert (scene.landmarks <= np.array(SMALL[::-1]) - 1).all()
    assert (scene.reflectance > 0).all() and (scene.reflectance <= 1.01).all()
    assert (scene.shading > 0).all()
    assert scene.shadow.min() >= 0 and scene.shadow.max() <= 1 + 1e-6
    assert scene.mask.any()


def test_a_lamp_alone_leaves_black_shadows_and_no_nan():
    for mixing in ("additive", "planckian"):
        scene = small_scene((PointLight((1, 0, 0.1)),), mixing=mixing)
        assert np.isfinite(scene.linear).all()
        assert scene.linear.min() == 0


def test_supersampling_does_not_move_the_picture():
    plain, other = small_scene(), render(Head(1), lights=SKY, size=SMALL, supersample=1)
    np.testing.assert_array_equal(plain.landmarks, other.landmarks)
    a, b = (np.log(s.reflectance[s.mask]).ravel() for s in (plain, other))
    assert np.corrcoef(a, b)[0, 1] > 0.93


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Head(-1), "Head.seed is -1"),
        (lambda: Head(1, hair="punk"), "'short', 'long' or None"),
        (lambda: Pose(yaw=2.0), "Pose.yaw is 2.0: give a number from -0.6 to 0.6"),
        (lambda: Expression(smile=1.5), "Expression.smile is 1.5: give a number from -1 to 1"),
        (lambda: PointLight((0, 0, 0)), "three numbers, not all zero"),
        (lambda: PointLight(temperature_K=100), "give 1500 to 20000 kelvin"),
        (lambda: lateral("top"), "'left' or 'right'"),
        (lambda: Camera(peaks_nm=(600, 500, 200)), "from 380 to 720 nm"),
        (lambda: Camera(bits=12), "8, 16 or None"),
        (lambda: Camera(response="log"), "'srgb', 'linear' or an exponent"),
        (lambda: Camera(read_noise=-1), "Camera.read_noise is -1"),
        (lambda: Camera().theta("laser"), "'wien' or 'planck'"),
        (lambda: render(Head(1), lights=()), "at least one PointLight or Ambient"),
        (lambda: render(Head(1), size=(10, 10)), "integers from 32"),
        (lambda: render(Head(1), mixing="both"), "'additive' or 'planckian'"),
        (lambda: render(Head(1), supersample=9), "1, 2, 3 or 4"),
        (lambda: make_set(0), "at least 1"),
    ],
)
def test_bad_arguments_name_the_fault_and_the_remedy(make, message):
    with pytest.raises(LiaamError, match=message):
        make()
