"""``liaam check``, and what ``liaam train`` says of landmarks in another order, as a person types it."""

import numpy as np
import pytest

from liaam import find_label_faults
from liaam.io import Contour, Landmarks, read_image, read_landmarks, write_image, write_landmarks
from liaam.plotting import overlay_of_faults
from scenes import Head, make_set

SPOILT = "face3"


@pytest.fixture(scope="module")
def scenes():
    return make_set(9, head=Head(5), size=(160, 120))


@pytest.fixture(scope="module")
def order(scenes):
    """Eight landmarks that spread far, run the other way round."""
    points = scenes[0].landmarks
    spread = [np.linalg.norm(np.ptp(points[i : i + 8], axis=0)) for i in range(len(points) - 7)]
    first, order = int(np.argmax(spread)), np.arange(len(points))
    order[first : first + 8] = order[first : first + 8][::-1]
    return order


def write_folder(folder, scenes, order=None, ending=".pts", **facts):
    for i, scene in enumerate(scenes):
        write_image(folder / f"face{i}.png", scene.image)
        points = scene.landmarks if order is None or f"face{i}" != SPOILT else scene.landmarks[order]
        write_landmarks(folder / f"face{i}{ending}", Landmarks(points, **facts))
    return folder


@pytest.fixture(scope="module")
def good(scenes, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("good"), scenes)


@pytest.fixture(scope="module")
def spoilt(scenes, order, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("spoilt"), scenes, order)


def test_check_says_that_all_is_well(run, good, tmp_path):
    code, text, err = run("check", good, "-o", tmp_path / "o")
    assert (code, err) == (0, "")
    assert "no faults found" in text and "not looked for" not in text
    drawn = sorted((tmp_path / "o").iterdir())  # a fault of all images would be in each of them
    assert len(drawn) == 4 and all(path.name.endswith("_landmarks.png") for path in drawn)
    picture = read_image(drawn[0]).astype(int)
    assert ((picture[..., 1] > 200) & (picture[..., 0] < 100)).sum() > 50  # landmarks


def test_check_says_what_it_cannot_judge_with_few_landmarks(run, scenes, tmp_path):
    for i, scene in enumerate(scenes):
        write_image(tmp_path / f"face{i}.png", scene.image)
        write_landmarks(tmp_path / f"face{i}.pts", Landmarks(scene.landmarks[[0, 20, 40]]))
    code, text, _ = run("check", tmp_path)
    assert code == 0
    said = "misplaced and mirrored landmarks were not looked for: 4 landmarks are needed, and each image has 3"
    assert said in " ".join(text.split())
    assert not (tmp_path / "o").exists()


def test_check_names_copies_of_an_image(run, scenes, tmp_path):
    folder = write_folder(tmp_path, scenes)
    (folder / "face7.png").write_bytes((folder / "face2.png").read_bytes())
    code, text, err = run("check", folder)
    assert code == 1 and "no other faults" in text
    assert "copies of one image: face2.png = face7.png; keep one of each" in " ".join(err.split())


def test_check_finds_landmarks_outside_of_their_image(run, scenes, tmp_path):
    folder = write_folder(tmp_path, scenes)
    write_landmarks(folder / "face4.pts", Landmarks(scenes[4].landmarks + 500))
    code, text, err = run("check", folder)
    assert code == 1 and "no other faults" in text
    n = len(scenes[4].landmarks)
    assert f"face4: {n} of {n} landmarks lie outside the image of 120×160 pixels" in err
    assert "they belong to another image" in err


def test_check_and_training_name_images_that_cut_an_object_off(run, scenes, tmp_path):
    folder = write_folder(tmp_path, scenes)
    picture = scenes[4].image
    right = int(scenes[4].landmarks[:, 0].max()) - 1  # the outermost landmark is just outside
    write_image(folder / "face4.png", picture[:, :right])
    n = int((scenes[4].landmarks[:, 0] > right - 0.5).sum())
    said = f"1 image has landmarks outside of the image: face4 ({n} of {len(scenes[4].landmarks)}); correct them"
    _, _, err = run("check", folder)
    assert said in " ".join(err.split())
    _, _, err = run("train", folder, "-o", tmp_path / "m.liaam", "--copies", 0, "--no-leave-out", "--diagonal", 50)
    assert " ".join(err.split()).count(said) == 1


def test_check_finds_shows_and_mends(run, scenes, spoilt, tmp_path):
    before = {path.name: path.read_bytes() for path in spoilt.iterdir()}
    code, text, err = run("check", spoilt, "-o", tmp_path / "o")
    assert (code, err) == (1, "")
    assert SPOILT in text
    assert "in reverse order" in " ".join(text.split())
    of_fault = sorted(path.name for path in (tmp_path / "o").iterdir() if not path.stem.endswith("_landmarks"))
    assert of_fault == [f"{SPOILT}.pts", f"{SPOILT}_faults.png"]
    corrected = read_landmarks(tmp_path / "o" / f"{SPOILT}.pts").points
    assert np.abs(corrected - scenes[int(SPOILT[-1])].landmarks).max() < 1e-3
    picture = read_image(tmp_path / "o" / f"{SPOILT}_faults.png").astype(int)
    red = (picture[..., 0] > 200) & (picture[..., 1] < 80) & (picture[..., 2] < 80)
    assert red.sum() > 50  # landmarks at fault
    assert {path.name: path.read_bytes() for path in spoilt.iterdir()} == before


def test_what_pts_cannot_hold_is_written_as_ljson(run, scenes, order, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    write_folder(folder, scenes, order, ".ljson", contours=(Contour((0, 1, 2)),))
    assert run("check", folder, "-o", tmp_path / "o")[0] == 1
    assert read_landmarks(tmp_path / "o" / f"{SPOILT}.ljson").contours == (Contour((0, 1, 2)),)


@pytest.mark.parametrize("inside", [".", "deep/er"])
def test_check_never_writes_into_the_folder(run, spoilt, inside):
    code, _, err = run("check", spoilt, "-o", spoilt / inside)
    assert code == 1
    assert "is inside the folder to check" in err
    assert "give another folder with -o" in err
    assert not (spoilt / "deep").exists()


def test_a_file_as_output_folder_is_refused_at_once(run, good, tmp_path):
    (tmp_path / "out.png").write_bytes(b"a picture")
    code, out, err = run("check", good, "-o", tmp_path / "out.png")
    assert (code, out) == (1, "") and "out.png is a file; give a folder with -o" in err


def test_check_never_writes_over_landmarks(run, spoilt, tmp_path):
    other = tmp_path / f"{SPOILT}.pts"
    other.write_text("mine")
    code, _, err = run("check", spoilt, "-o", tmp_path)
    assert code == 1
    assert "already exists and is not overwritten" in err
    assert other.read_text() == "mine"


def test_a_picture_that_cannot_be_read_costs_its_picture_only(run, scenes, order, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    write_folder(folder, scenes, order)
    (folder / f"{SPOILT}.png").write_bytes((folder / f"{SPOILT}.png").read_bytes()[:200])
    code, text, err = run("check", folder, "-o", tmp_path / "o")
    assert code == 1
    assert f"{SPOILT}.png" in err
    assert "1 landmark file in the corrected order" in " ".join(text.split())
    of_fault = [path.name for path in (tmp_path / "o").iterdir() if not path.stem.endswith("_landmarks")]
    assert of_fault == [f"{SPOILT}.pts"]


def test_landmarks_outside_the_picture_are_drawn_on_the_whole(order, scenes):
    points = [scene.landmarks for scene in scenes]
    points[3] = points[3][order] + 5000
    (fault,) = find_label_faults(points)
    picture = overlay_of_faults(scenes[3].image, points[3], [fault])
    height, width = scenes[3].image.shape[:2]
    assert picture.shape[0] * width == picture.shape[1] * height


def test_names_are_printed_as_they_are(run, scenes, order, tmp_path):
    write_folder(tmp_path, scenes, order)
    for ending in (".png", ".pts"):
        (tmp_path / f"{SPOILT}{ending}").rename(tmp_path / f"[bold]3{ending}")
    assert "[bold]3" in run("check", tmp_path)[1]


def test_check_needs_some_pictures(run, good, tmp_path):
    code, _, err = run("check", good / "face[0-3]*")
    assert code == 1
    assert "too few landmarked images to find unusual landmarks (4)" in err
    assert "does not exist" in run("check", tmp_path / "none")[2]


def test_check_finds_faults_of_incomplete_images(run, scenes, tmp_path):
    write_folder(tmp_path, scenes)
    for i, scene in enumerate(scenes):
        points = scene.landmarks.copy()
        points[4 + i] = np.nan
        write_landmarks(tmp_path / f"face{i}.pts", points)
    code, text, err = run("check", tmp_path)
    assert (code, err) == (0, "")
    assert "9 images with missing landmarks, which are estimated to compare the others" in " ".join(text.split())
    assert "no faults" in text
    points = scenes[0].landmarks.copy()
    points[30] += 25
    points[4] = np.nan
    write_landmarks(tmp_path / "face0.pts", points)
    code, text, _ = run("check", tmp_path)
    assert code == 1 and "face0" in text and "point 31 may be misplaced" in " ".join(text.split())


def test_check_skips_images_whose_landmarks_cannot_be_estimated(run, scenes, tmp_path):
    write_folder(tmp_path, scenes)
    points = np.full_like(scenes[0].landmarks, np.nan)
    points[:2] = scenes[0].landmarks[:2]
    write_landmarks(tmp_path / "face0.pts", points)
    code, text, err = run("check", tmp_path)
    assert code == 0 and "no faults" in text
    assert "skipped 1 image with fewer than 3 landmarks: face0" in " ".join(err.split())


def test_training_says_so(run, good, spoilt, tmp_path):
    options = ("--diagonal", 40, "--no-leave-out", "--copies", 0, "-o", tmp_path / "m.liaam")
    code, _, err = run("train", spoilt, *options)
    assert err.splitlines()[0].startswith(f"{SPOILT}: points")
    assert "liaam check" in err.splitlines()[1]
    assert code == 0
    assert f"fold the mesh (share of its area that is flipped: {SPOILT}" in err and "left out" in err
    assert run("train", good, *options)[2] == ""


def test_training_names_points_far_off(run, scenes, tmp_path):
    folder = write_folder(tmp_path, scenes)
    points = scenes[4].landmarks.copy()
    points[30] += 25
    write_landmarks(folder / "face4.pts", Landmarks(points))
    _, _, err = run("train", folder, "--diagonal", 40, "--no-leave-out", "--copies", 0, "-o", tmp_path / "m.liaam")
    assert err.splitlines()[0].startswith("face4: point 31")
    assert "liaam check" in err.splitlines()[1]


def test_training_finds_the_faults_of_incomplete_images_as_check_does(run, scenes, tmp_path):
    folder = write_folder(tmp_path, scenes)
    for i, scene in enumerate(scenes):
        points = scene.landmarks.copy()
        points[4 + i] = np.nan
        if i == 4:
            points[30] += 25
        write_landmarks(folder / f"face{i}.pts", points)
    poor = scenes[8].landmarks.copy()
    poor[2:] = np.nan
    write_landmarks(folder / "face8.pts", poor)
    _, text, _ = run("check", folder)
    assert "point 31 may be misplaced" in " ".join(text.split())
    _, text, err = run("train", folder, "--diagonal", 40, "--no-leave-out", "--copies", 0, "-o", tmp_path / "m.liaam")
    assert "8 images with missing landmarks, which are estimated to compare the others" in " ".join(text.split())
    assert err.splitlines()[0].startswith("face4: point 31 may be misplaced")
    assert " ".join(err.split()).count("face8") == 1  # by training alone


def test_training_and_check_count_sides_alike(run, tmp_path, rng):
    shape = np.array([[40, 60], [66, 54], [92, 64], [100, 82], [74, 90], [48, 84], [64, 72], [80, 74]], float)
    for i in range(12):
        for side in ("left", "right"):
            points = shape + rng.normal(0, 0.5, shape.shape)
            points = points * [-1, 1] + [140, 0] if side == "left" else points
            if i % 3 == 0:
                points[i // 3] = np.nan
            name = f"fly{i}_{side}"
            write_image(tmp_path / f"{name}.png", rng.integers(0, 255, (120, 140, 3), np.uint8))
            write_landmarks(tmp_path / f"{name}.pts", points)
    lines = []
    for command in (("check",), ("train", "--no-leave-out", "--diagonal", 40, "-o", tmp_path / "m.liaam")):
        _, text, _ = run(command[0], tmp_path, *command[1:])
        lines += [line for line in text.splitlines() if line.startswith("side left")]
    assert len(lines) == 2 and lines[0] == lines[1] and "12 of 24 images" in lines[0]


@pytest.mark.parametrize(
    ("given", "advice"),
    [
        (("drawer", "3"), "; put quotes around a name with blanks: 'drawer 3'"),
        (("drawer", "4"), "check --help'"),
        (("x",) * 10_000, "check --help'"),
    ],
)
def test_a_folder_with_a_blank_needs_quotes(run, tmp_path, monkeypatch, given, advice):
    (tmp_path / "drawer 3").mkdir()
    monkeypatch.chdir(tmp_path)
    code, _, err = run("check", *given)
    assert code == 2 and "extra argument" in err and err.rstrip().endswith(advice)
