"""Calibrating, looking at and aligning pictures from the command line, as a person types it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from liaam.io import read_image, write_image, write_landmarks
from liaam.photometry import CameraModel, load_camera
from scenes import (
    Camera,
    Head,
    colour_chart,
    even_light,
    lateral,
    make_set,
    narrow_band_camera,
    photograph,
    poster,
    render,
    uneven_light,
)

SIZE = (120, 160)
CAMERA = replace(narrow_band_camera(response="srgb"), bits=8, read_noise=0.002)
TRUTH = CAMERA.theta("wien")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures a.png, b.png, c.png of one poster, of which c is moved; chart1.png, chart2.png; grey.png; flat.png."""
    folder = tmp_path_factory.mktemp("pictures")
    sheet, moved = poster(SIZE, 3), np.array([[1, 0.01, 2.4], [-0.01, 1, -1.7], [0, 0, 1.0]])
    for name, seed, homography in (("a", 1, None), ("b", 2, None), ("c", 2, moved)):
        light = uneven_light(SIZE, seed, lamp_K=3600 if name == "a" else 5500)
        write_image(folder / f"{name}.png", photograph(sheet, light, CAMERA, seed=seed, homography=homography))
    write_image(folder / "again.png", photograph(sheet, uneven_light(SIZE, 1), CAMERA, seed=9))
    reflectance, _ = colour_chart()
    for i, kelvin in enumerate((3200, 6500)):
        light = even_light(reflectance.shape[:2], kelvin)
        write_image(folder / f"chart{i + 1}.png", photograph(reflectance, light, CAMERA))
    (folder / "other.json").write_text("{}")
    write_image(folder / "grey.png", np.full((*SIZE, 3), 120, np.uint8))
    for i, exposure in enumerate((0.2, 0.4, 0.8)):
        write_image(folder / f"e{i}.png", photograph(sheet, even_light(SIZE), CAMERA, exposure=exposure, seed=i))
    dimmed = replace(even_light(SIZE), strength=CameraModel(vignetting=(-0.5,)).falloff(*SIZE))
    write_image(folder / "flat.png", photograph(np.full((*SIZE, 3), 0.6), dimmed, CAMERA, exposure=1.0))
    return folder


CHART = "20.5,20.5,200.5,20.5,200.5,128.5,20.5,128.5"


def theta_of(path):
    return np.rad2deg(load_camera(path).theta)


@pytest.mark.parametrize(
    ("arguments", "limit"),
    [
        (("scene", "a.png", "b.png"), 0.5),
        (("scene", "a.png", "c.png"), 1.0),
        (("chart", "chart1.png", "chart2.png", "--patches", CHART), 0.5),
    ],
)
def test_calibrate_writes_a_camera_and_a_picture_to_check_it_by(run, folder, tmp_path, arguments, limit):
    kind, *rest = arguments
    given = [folder / part if part.endswith(".png") else part for part in rest]
    code, out, err = run("camera", kind, *given, "-o", tmp_path / "camera.json")
    assert (code, err) == (0, "")
    assert "theta 12" in out and "95 % interval" in out and "log R/B" in out
    assert abs(theta_of(tmp_path / "camera.json") - np.rad2deg(TRUTH)) < limit
    assert read_image(tmp_path / "camera_check.png").shape[2] == 3
    assert load_camera(tmp_path / "camera.json").history


def test_spectral(run, tmp_path):
    code, _, err = run("camera", "spectral", "610,540,450", "-o", tmp_path / "camera.json")
    assert (code, err) == (0, "")
    assert theta_of(tmp_path / "camera.json") == pytest.approx(122.43, abs=0.1)
    curves = ["wavelength_nm,R,G,B", *(sensitivities(w) for w in range(400, 701, 2))]
    (tmp_path / "curves.csv").write_text("\n".join(curves))
    assert run("camera", "spectral", tmp_path / "curves.csv", "-o", tmp_path / "other.json")[0] == 0
    assert theta_of(tmp_path / "other.json") == pytest.approx(122.43, abs=1.5)


def sensitivities(wavelength):
    return ",".join(map(str, [wavelength, *np.exp(-0.5 * ((wavelength - np.array([610, 540, 450])) / 6) ** 2)]))


def test_calibrations_add_up_in_one_file(run, folder, tmp_path):
    path = tmp_path / "camera.json"
    assert run("camera", "noise", folder / "a.png", folder / "again.png", "-o", path)[0] == 0
    assert run("camera", "vignetting", folder / "flat.png", "-o", path)[0] == 0
    code, _out, _ = run("camera", "scene", folder / "a.png", folder / "b.png", "-o", path)
    assert code == 0
    camera = load_camera(path)
    assert camera.noise is not None and len(camera.history) == 3
    assert camera.falloff(*SIZE)[0, 0] == pytest.approx(0.5, abs=0.03)
    assert abs(camera.theta - TRUTH) < np.deg2rad(0.5)


def test_calibrate_response_from_exposures(run, folder, tmp_path):
    from liaam.photometry import to_linear

    files = [folder / f"e{i}.png" for i in range(3)]
    code, _out, err = run("camera", "response", *files, "--exposures", "1,2,4", "-o", tmp_path / "camera.json")
    assert (code, err) == (0, "")
    stored = np.linspace(0.1, 0.9, 30)
    logs = [np.log(to_linear(stored, r)) for r in (load_camera(tmp_path / "camera.json").response, "srgb")]
    difference = logs[0] - logs[1]
    assert np.std(difference) < 0.03
    assert read_image(tmp_path / "camera_check.png").shape[2] == 3


def test_a_known_response_begins_a_camera_file_and_a_later_one_takes_off_what_hung_on_it(run, folder, tmp_path):
    path = tmp_path / "camera.json"
    assert run("camera", "response", "linear", "-o", path)[0] == 0
    assert run("camera", "noise", folder / "a.png", folder / "again.png", "-o", path)[0] == 0
    camera = load_camera(path)
    assert camera.response == "linear" and camera.noise is not None and len(camera.history) == 2
    _, out, _ = run("camera", "response", "2.2", "-o", path)
    assert "estimated with another response" in out
    assert load_camera(path).response == 2.2 and load_camera(path).noise is None


def test_what_cannot_be_told_is_not_written(run, folder, tmp_path):
    path = tmp_path / "camera.json"
    code, _out, err = run("camera", "scene", folder / "a.png", folder / "a.png", "-o", path)
    assert code != 0
    assert "nothing was written" in err and "hardly differ" in err
    assert not path.exists()


@pytest.mark.slow
def test_faces_pool_their_angles(run, tmp_path):
    camera = Camera(widths_nm=(0, 0, 0))
    for i, scene in enumerate(make_set(6, head=Head(5), camera=camera, size=(200, 150))):
        write_image(tmp_path / f"face{i}.png", scene.image)
        write_landmarks(tmp_path / f"face{i}.pts", scene.landmarks)
    options = ("--diagonal", 100, "--methods", "li-pcs,soft-li")
    assert run("train", tmp_path, "-o", tmp_path / "m.liaam", *options)[0] == 0
    lit = tmp_path / "lit"
    lit.mkdir()
    for i in range(6):
        lights = lateral("left" if i % 2 else "right", azimuth=0.5 + 0.1 * i, temperature_K=3000 + 200 * i)
        scene = render(Head(5), lights=lights, camera=camera, size=(200, 150), seed=i, mixing="planckian")
        write_image(lit / f"p{i}.png", scene.image)
        write_landmarks(lit / f"p{i}.pts", scene.landmarks + 1.0)
    files = sorted(lit.glob("*.png"))
    code, out, err = run("camera", "faces", tmp_path / "m.liaam", *files, "--init", lit, "-o", tmp_path / "c.json")
    assert (code, err) == (0, "")
    assert abs(load_camera(tmp_path / "c.json").theta - camera.theta("wien")) < np.deg2rad(2.0)
    # And the camera file is one that train and fit take.
    known = "--camera", tmp_path / "c.json"
    assert run("fit", tmp_path / "m.liaam", files[0], "--init", lit, *known, "-o", tmp_path / "fits")[0] == 0
    short = "--diagonal", 100, "--no-leave-out", "--copies", 0
    assert run("train", tmp_path, "-o", tmp_path / "n.liaam", *short, *known)[0] == 0
    code, out, _ = run("show", tmp_path / "n.liaam")
    assert "± " in out


def test_invariant_writes_a_picture_and_numbers(run, folder, tmp_path):
    out = tmp_path / "out"
    files = folder / "a.png", folder / "b.png"
    code, text, err = run("camera", "invariant", *files, "--camera", "122.4", "--sweep", "--compare", "-o", out)
    assert (code, err) == (0, "")
    values, tiff = np.load(out / "a_invariant.npy"), read_image(out / "a_invariant.tif")
    assert values.dtype == np.float32 and values.shape == SIZE
    np.testing.assert_array_equal(tiff[..., 0] if tiff.ndim == 3 else tiff, values)
    for name in ("a_invariant.png", "a_sweep.png", "b_sweep.png", "agreement.png"):
        assert read_image(out / name).shape[2] == 3
    header, row = (out / "agreement.csv").read_text().splitlines()
    assert header == "first,second,invariant,log_grey,share"
    assert float(row.split(",")[2]) > 0.99
    assert "median correlation: invariant 0.99" in text


def test_register_writes_the_picture_the_homography_and_a_check(run, folder, tmp_path):
    code, _out, err = run("camera", "register", folder / "a.png", folder / "c.png", "-o", tmp_path / "c_on_a.png")
    assert (code, err) == (0, "")
    facts = json.loads((tmp_path / "c_on_a_homography.json").read_text())
    assert np.abs(np.array(facts["homography"]) - [[1, 0.01, 2.4], [-0.01, 1, -1.7], [0, 0, 1]]).max() < 0.3
    assert read_image(tmp_path / "c_on_a.png").shape == (*SIZE, 3)
    assert read_image(tmp_path / "c_on_a_check.png").shape == (*SIZE, 3)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ("camera scene none.png b.png", "none.png"),
        ("camera scene a.png grey.png", "grey"),
        ("camera scene a.png", "give 2 or more"),
        ("camera chart chart1.png chart2.png", "--patches"),
        ("camera chart chart1.png chart2.png --patches 1,2,3", "8 numbers"),
        ("camera chart chart1.png chart2.png --patches 0,0,500,0,500,100,0,100", "outside the image"),
        ("camera chart chart1.png chart2.png --patches none.csv", "none.csv"),
        ("camera spectral", "PEAKS"),
        ("camera spectral 610,540", "3 numbers"),
        ("camera spectral none.csv", "none.csv"),
        ("camera response film", "neither an image nor a response"),
        ("camera noise a.png b.png c.png", "--flat"),
        ("camera scene a.png b.png -o none/camera.json", "does not exist"),
        ("camera register a.png b.png --camera a.png", "not a camera file"),
        ("camera register a.png b.png --camera film", "film"),
        ("camera scene a.png b.png -o other.json", "not a camera file"),
        ("camera image grey.png", "grey"),
        ("camera invariant grey.png", "grey"),
        ("camera invariant a.png --camera 1000", "the angle theta"),
        ("camera invariant a.png --compare", "two or more"),
        ("camera invariant a.png grey.png --compare -o compared", "grey.png: the image is grey"),
        ("camera register a.png none.png", "none.png"),
        ("camera register a.png b.png --warp rubber", "rubber"),
    ],
)
def test_mistakes_are_named(run, folder, monkeypatch, arguments, fault):
    monkeypatch.chdir(folder)
    code, _, err = run(*arguments.split())
    assert code != 0
    assert fault in err
    assert "Traceback" not in err
    assert not (folder / "compared").exists()


@pytest.mark.parametrize(
    "kind",
    [
        "",
        *(
            f" {k}"
            for k in [
                "spectral",
                "scene",
                "chart",
                "image",
                "faces",
                "response",
                "vignetting",
                "noise",
                "invariant",
                "register",
            ]
        ),
    ],
)
def test_every_calibration_explains_itself(run, kind):
    code, out, _ = run(*f"camera{kind} --help".split())
    assert code == 0
    assert "camera" in out.lower()
