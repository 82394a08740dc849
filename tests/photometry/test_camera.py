"""Camera files: small, readable, complete, and checked when read."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.calibration import AngleEstimate
from liaam.errors import CameraError
from liaam.photometry import CameraModel, NoiseModel, ResponseCurve, load_camera
from liaam.photometry.camera import least_share
from liaam.photometry.encoding import SATURATED

KNOWN = CameraModel(
    theta=np.deg2rad(121.25),
    theta_deviation=np.deg2rad(0.5),
    response=ResponseCurve((0.05, 0.5, 1.0), (0.002, 0.2, 1.0)),
    vignetting=(-0.2, 0.05),
    noise=NoiseModel(1e-4, 2e-6),
    history=("theta from a chart", "Größe geprüft"),
)


@pytest.mark.parametrize("camera", [CameraModel(), KNOWN, CameraModel(response=2.2), CameraModel(response="linear")])
def test_a_camera_is_read_as_it_was_written(tmp_path, camera):
    camera.save(tmp_path / "camera.json")
    back = load_camera(tmp_path / "camera.json")
    assert back.theta == pytest.approx(camera.theta, abs=1e-8)
    assert back.theta_deviation == (None if camera.theta_deviation is None else pytest.approx(camera.theta_deviation))
    assert (back.response, back.vignetting, back.noise) == (camera.response, camera.vignetting, camera.noise)
    assert back.history == camera.history


def test_a_camera_file_is_for_people(tmp_path):
    KNOWN.save(tmp_path / "camera.json")
    text = (tmp_path / "camera.json").read_text(encoding="utf-8")
    assert '"theta_deg": 121.25' in text
    assert '"theta_standard_error_deg": 0.5' in text
    assert "Größe" in text
    assert len(text) < 1500


def change(path, **facts):
    KNOWN.save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | facts))


@pytest.mark.parametrize(
    ("facts", "fault"),
    [
        ({"format": "else"}, "not a camera file"),
        ({"version": 9}, "version 9"),
        ({"theta_deg": "wide"}, "contradicts itself"),
        ({"theta_deg": 1e6}, "contradicts itself.*theta"),
        ({"theta_standard_error_deg": -1}, "contradicts itself.*theta_deviation"),
        ({"response": "film"}, "contradicts itself.*film"),
        ({"response": {"stored": [0.1, 0.5]}}, "contradicts itself.*stored"),
        ({"response": {"stored": [0.5, 0.1], "linear": [0.1, 0.5]}}, "contradicts itself.*increase"),
        ({"vignetting": [-1.5]}, "contradicts itself.*vignetting"),
        ({"noise": {"slope": -1, "offset": 0}}, "contradicts itself.*noise"),
        ({"noise": {"slope": 1}}, "contradicts itself.*offset"),
        ({"noise": {"slope": 1e300, "offset": 0}}, "contradicts itself.*at most"),
        ({"noise": {"slope": float("nan"), "offset": 0}}, "contradicts itself.*noise"),
        ({"noise": [1]}, "contradicts itself"),
        ({"vignetting": [1e300]}, "contradicts itself.*times the light"),
        ({"vignetting": [float("nan")]}, "contradicts itself.*vignetting"),
        ({"vignetting": [0.0] * 17}, "contradicts itself.*17 coefficients"),
        ({"theta_standard_error_deg": float("inf")}, "contradicts itself.*theta_deviation"),
        ({"response": {"stored": [0.1, 1], "linear": [1e-30, 1e30]}}, "contradicts itself.*1e30"),
        ({"response": {"stored": [0.1, 1], "linear": [1e-300, 1e-299]}}, "contradicts itself.*1e-299"),
        ({"response": {"stored": [0.1, 1], "linear": [1e300, 1e301]}}, "contradicts itself.*1e301"),
        ({"response": {"stored": [0.5, 0.5 + 1e-8, 1], "linear": [1e-2, 0.5, 1]}}, "contradicts itself.*almost equal"),
        ({"response": {"stored": [1e-300, 1.1e-300], "linear": [1e-9, 1]}}, "contradicts itself.*response"),
        ({"respnse": "srgb"}, "unknown entry respnse"),
        ({"theta_deg": 10**400}, "contradicts itself"),
        ({"theta_deg": None}, "contradicts itself"),
        ({"vignetting": 3}, "contradicts itself"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path, facts, fault):
    path = tmp_path / "camera.json"
    change(path, **facts)
    with pytest.raises(CameraError, match=fault) as caught:
        load_camera(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "nonsense", "[" * 100_000])
def test_a_file_that_is_no_camera_is_refused(tmp_path, text):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(CameraError, match=r"(not a camera file; make one|is empty.* made) with 'liaam camera'"):
        load_camera(path)


def test_a_missing_file_names_the_remedy(tmp_path):
    with pytest.raises(CameraError, match=r"none.json.*liaam camera"):
        load_camera(tmp_path / "none.json")


def test_a_file_that_cannot_be_written_says_so(tmp_path):
    with pytest.raises(CameraError, match="does not exist"):
        KNOWN.save(tmp_path / "no" / "camera.json")


def test_light_falls_off_towards_the_corners():
    share = CameraModel(vignetting=(-0.3, 0.1)).falloff(61, 81)
    assert share.dtype == np.float32
    assert share[30, 40] == 1.0
    assert share[0, 0] == pytest.approx(0.8)
    np.testing.assert_allclose(share, share[::-1, ::-1])
    assert (CameraModel().falloff(5, 9) == 1).all()


@pytest.mark.parametrize("vignetting", [(-0.5,), (0.3,)])
def test_flattening_undoes_vignetting_and_leaves_dark_and_clipped_pixels_what_they_are(vignetting):
    camera = CameraModel(vignetting=vignetting, response="linear")
    flat = camera.flatten((0.5 * camera.falloff(40, 60)[..., None] * np.ones(3) * 65535).astype(np.uint16))
    np.testing.assert_allclose(flat, 0.5, atol=1e-4)
    odd = np.full((40, 60, 3), 0.8, np.float32)
    odd[0, 0], odd[0, 1], odd[0, 2] = 1.0, 0.01, np.nan
    flat = camera.flatten(odd)
    assert flat[0, 0].min() == 1.0 and flat[0, 1].max() < 0.02 and np.isnan(flat[0, 2]).all()
    assert np.nanmax(flat[1:]) <= SATURATED
    assert CameraModel().flatten(odd) is odd


def test_noise_grows_with_the_light():
    assert NoiseModel(1e-3, 1e-5).variance(np.array([0.0, 0.5, -1.0])).tolist() == [1e-5, 5.1e-4, 1e-5]


@given(
    stored=st.lists(st.floats(0.01, 1.0), min_size=2, max_size=12, unique_by=lambda v: round(v, 2)),
    growth=st.lists(st.floats(0.05, 2.5), min_size=12, max_size=12),
    value=st.floats(0.03, 1.0),
)
def test_a_curve_encodes_what_it_decodes_and_rises(stored, growth, value):
    from liaam.photometry import from_linear, log_slope, to_linear

    stored = tuple(sorted(stored))
    steps = np.diff(np.log(stored), append=0.0)  # rising by some power from point to point
    curve = ResponseCurve(stored, tuple(np.exp(-np.cumsum((steps * growth[: len(stored)])[::-1])[::-1])))
    light = to_linear(np.array([value, value * 1.001]), curve)
    assert light[1] > light[0] > 0
    assert from_linear(light, curve)[0] == pytest.approx(value, rel=1e-6)
    assert (log_slope(np.array(value), curve) > 0).all()
    np.testing.assert_allclose(to_linear(np.array(stored), curve), curve.linear, rtol=1e-9)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("power", [1.0, 2.2])
@pytest.mark.parametrize("count", [17, None])
def test_curves_with_a_black_level_are_cameras(bits, power, count):
    from liaam.photometry import from_linear, to_linear

    scale = 2 ** (bits - 8)
    codes = np.arange(16 * scale + 1, 235 * scale + 1)
    codes = codes if count is None else codes[np.linspace(0, len(codes) - 1, count).astype(int)]
    light = ((codes - 16 * scale) / (219.0 * scale)) ** power
    curve = ResponseCurve(tuple(codes / (2.0**bits - 1)), tuple(light))
    assert (np.diff(to_linear(np.linspace(0.005, 1.0, 200), curve)) > 0).all()
    above = np.linspace(0.07, 1.0, 200)
    np.testing.assert_allclose(from_linear(to_linear(above, curve), curve), above, rtol=1e-5)


def test_a_curve_of_two_points_is_a_gamma():
    from liaam.photometry import log_slope, to_linear

    curve, v = ResponseCurve((0.1, 1.0), (0.1**2.2, 1.0)), np.linspace(0.01, 1, 50)
    np.testing.assert_allclose(to_linear(v, curve), v**2.2, rtol=1e-9)
    np.testing.assert_allclose(log_slope(v, curve), 2.2 / v, rtol=1e-9)
    assert to_linear(np.array([0.0, -1.0]), curve).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("theta", "error", "physical"), [(122, 0.1, True), (60, 1, False), (88, 2, True), (60, np.inf, True)]
)
def test_angles_of_physical_cameras(theta, error, physical):
    estimate = AngleEstimate(np.deg2rad(theta), np.deg2rad(error), "", 0.0, 1)
    assert estimate.physical is physical


def test_an_interval_follows_from_the_standard_error():
    told = AngleEstimate(2.0, 0.1, "", 0.0, 1)
    assert told.observable and told.interval == pytest.approx((1.804, 2.196))
    untold = replace(told, standard_error=np.inf)
    assert not untold.observable and untold.interval == (0.0, np.pi)


@pytest.mark.parametrize("kind", ["fifo", "device", "large", "long name"])
def test_what_is_no_file_on_disk_is_refused_before_it_is_read(tmp_path, kind):
    path = tmp_path / ("a" * 300 if kind == "long name" else "camera.json")
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/zero")
    elif kind == "large":
        with path.open("wb") as file:
            file.truncate(10**8)
    message = {"large": "more than the", "long name": "name too long"}.get(kind, "is not a regular file")
    with pytest.raises(CameraError, match=f"(?i){message}"):
        load_camera(path)


def test_a_camera_file_needs_its_angle_only(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"format": "liaam-camera", "version": 1, "theta_deg": 90}))
    assert load_camera(path) == CameraModel(theta=np.pi / 2)
    path.write_text(json.dumps({"format": "liaam-camera", "version": 1}))
    with pytest.raises(CameraError, match=r"camera.json: the entry theta_deg is missing; the entries are theta_deg"):
        load_camera(path)


def test_the_history_of_a_camera_is_text_that_can_be_written(tmp_path):
    path = tmp_path / "camera.json"
    change(path, history=["a\ud800b", 7])
    assert load_camera(path).history == ("a?b", "7")


def test_unknown_angles_and_noise_are_written_as_null():
    facts = CameraModel().describe()
    assert (facts["theta_standard_error_deg"], facts["noise"]) == (None, None)
    facts = CameraModel(theta=1 / 3, theta_deviation=0.01).describe()
    assert (facts["theta_deg"], facts["theta_standard_error_deg"]) == (19.098593171, 0.572957795)


@pytest.mark.parametrize(
    ("facts", "allowed"),
    [
        ({"theta": 2 * np.pi}, True),
        ({"theta": -2 * np.pi}, True),
        ({"theta": 6.3}, False),
        ({"theta": -6.3}, False),
        ({"theta": np.nan}, False),
        ({"theta_deviation": 0.0}, True),
        ({"theta_deviation": -1e-9}, False),
        ({"theta_deviation": np.inf}, False),
        ({"theta_deviation": np.nan}, False),
        ({"vignetting": (0.0,) * 16}, True),
        ({"vignetting": (0.0,) * 17}, False),
        ({"vignetting": (-0.98,)}, True),
        ({"vignetting": (-0.981,)}, False),
        ({"vignetting": (49.0,)}, True),
        ({"vignetting": (49.1,)}, False),
        ({"vignetting": (-3.9, 3.9)}, True),
        ({"vignetting": (-4.0, 4.0)}, False),  # bright in the corners, and black on the way there
    ],
)
def test_cameras_at_their_limits(facts, allowed):
    if allowed:
        assert CameraModel(**facts)
        return
    with pytest.raises(CameraError, match=next(iter(facts))):
        CameraModel(**facts)


@pytest.mark.parametrize(
    ("slope", "offset", "allowed"),
    [(0, 0, True), (1e8, 1e8, True), (1.01e8, 0, False), (0, 1.01e8, False), (-1e-9, 0, False), (0, -1e-9, False)],
)
def test_noise_at_its_limits(slope, offset, allowed):
    if allowed:
        assert NoiseModel(slope, offset)
        return
    with pytest.raises(CameraError, match=f"noise of slope {slope} and offset {offset}: give two numbers"):
        NoiseModel(slope, offset)


def test_a_picture_of_one_pixel_has_no_corners():
    assert CameraModel(vignetting=(-0.5,)).falloff(1, 1).tolist() == [[1.0]]


def test_the_least_share_of_light_may_lie_anywhere():
    assert least_share((-0.3,)) == pytest.approx(0.7)
    assert least_share((-2.0, 2.0)) == pytest.approx(0.5, abs=1e-3)
    assert least_share(()) == 1.0


CURVE = ResponseCurve((0.1, 1.0), (0.1, 1.0))


@pytest.mark.parametrize(
    ("own", "raw", "asked", "expected"),
    [
        ("srgb", True, None, "linear"),
        (2.2, True, None, "linear"),
        (CURVE, True, None, CURVE),
        ("srgb", False, None, "srgb"),
        (2.2, False, None, 2.2),
        (CURVE, True, "1.8", 1.8),
        ("linear", False, "srgb", "srgb"),
    ],
)
def test_pictures_have_the_response_that_is_known_best(own, raw, asked, expected):
    assert CameraModel(response=own).suited_to(raw=raw, response=asked).response == expected


def test_flattening_changes_only_what_is_neither_dark_nor_clipped():
    camera = CameraModel(vignetting=(-0.5,), response="linear")
    image = np.full((9, 9, 3), 0.3, np.float32)
    image[0, 0], image[0, 8], image[8, 0] = 0.002, 0.99, np.inf
    flat = camera.flatten(image)
    assert flat[4, 4] == pytest.approx(np.full(3, 0.3))
    assert flat[8, 8] == pytest.approx(np.full(3, 0.6))
    assert flat[0, 0] == pytest.approx(np.full(3, 0.002))
    assert flat[0, 8] == pytest.approx(np.full(3, 0.99))
    assert np.isnan(flat[8, 0]).all()
    whole = CameraModel(vignetting=(-0.5,)).flatten(np.full((9, 9, 3), 5, np.uint8))
    assert whole.dtype == np.float32 and whole == pytest.approx(np.full((9, 9, 3), 5 / 255))
