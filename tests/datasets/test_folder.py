"""Folders: which images are paired with which landmarks, and what is left out and why."""

import json
from pathlib import Path

import numpy as np
import pytest

from liaam.datasets import Dataset, Sample, UnusedFile, load_folder
from liaam.errors import ImageError, LandmarkError, LiaamError
from liaam.io import Landmarks, write_collection, write_image, write_landmarks

SQUARE = np.array([[1.0, 1.0], [5.0, 1.0], [5.0, 4.0], [1.0, 4.0]])


def add_image(path: Path, value: int = 0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, np.full((6, 8, 3), value, np.uint8))
    return path


def add_pair(folder: Path, stem: str, points: np.ndarray = SQUARE, suffix: str = ".pts") -> None:
    add_image(folder / f"{stem}.png")
    write_landmarks(folder / f"{stem}{suffix}", points)


def write_asf(path: Path, host: str) -> None:
    rows = [f"0 0 {x / 8} {y / 6} {i} {(i - 1) % 4} {(i + 1) % 4}" for i, (x, y) in enumerate(SQUARE)]
    path.write_text("\n".join(["4", *rows, host]))


def names(dataset: Dataset) -> list[str]:
    return [sample.name for sample in dataset]


def reasons(dataset: Dataset) -> dict[str, str]:
    return {left.path.name: left.reason for left in dataset.left_out}


# Pairing -------------------------------------------------------------------------------------------


def test_pairs_by_stem_in_natural_order(tmp_path: Path) -> None:
    for stem in ("img10", "img2", "IMG1"):
        add_pair(tmp_path, stem)
    dataset = load_folder(tmp_path)
    assert names(dataset) == ["IMG1", "img2", "img10"]
    assert dataset.left_out == ()
    assert dataset[0].image == tmp_path / "IMG1.png"
    assert dataset[0].landmark_file == tmp_path / "IMG1.pts"
    np.testing.assert_array_equal(dataset[2].landmarks.points, SQUARE)


@pytest.mark.parametrize("suffix", [".pts", ".csv", ".ljson"])
def test_every_format_of_one_image(tmp_path: Path, suffix: str) -> None:
    add_pair(tmp_path, "a", suffix=suffix)
    np.testing.assert_array_equal(load_folder(tmp_path)[0].landmarks.points, SQUARE)


def test_asf_takes_the_size_from_the_header_of_its_image(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:50])  # the size is there, but no pixel could be decoded
    write_asf(tmp_path / "a.asf", "a.png")
    np.testing.assert_array_equal(load_folder(tmp_path)[0].landmarks.points, SQUARE)


def test_asf_of_another_stem_is_paired_by_the_image_it_names(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    write_asf(tmp_path / "shape_17.asf", "a.png")
    dataset = load_folder(tmp_path)
    assert names(dataset) == ["a"]
    np.testing.assert_array_equal(dataset[0].landmarks.points, SQUARE)
    write_asf(tmp_path / "shape_18.asf", "b.png")
    assert reasons(load_folder(tmp_path)) == {"shape_18.asf": "no image has its name"}


def test_collections(tmp_path: Path) -> None:
    for stem in ("a", "b", "c"):
        add_image(tmp_path / "images" / f"{stem}.png")
    write_collection(tmp_path / "all.csv", {"a.png": Landmarks(SQUARE), "gone.png": Landmarks(SQUARE)})
    part = "".join(f"<part name='{i}' x='{x:g}' y='{y:g}'/>" for i, (x, y) in enumerate(SQUARE))
    box = f"<box top='0' left='0' width='8' height='6'>{part}</box>"
    (tmp_path / "all.xml").write_text(f"<dataset><image file='images\\b.png'>{box}</image></dataset>")
    keypoints = [value for x, y in SQUARE for value in (x, y, 2)]
    coco = {
        "images": [{"id": 1, "file_name": "c.png"}],
        "annotations": [{"image_id": 1, "keypoints": keypoints}],
    }
    (tmp_path / "all.json").write_text(json.dumps(coco))
    dataset = load_folder(tmp_path, recursive=True)
    assert names(dataset) == ["images/a", "images/b", "images/c"]
    assert [sample.landmark_file for sample in dataset] == [
        tmp_path / name for name in ("all.csv", "all.xml", "all.json")
    ]
    assert all((sample.landmarks.points == SQUARE).all() for sample in dataset)
    assert reasons(dataset) == {"all.csv": "1 of its 2 images is not in the folder (gone.png); the others are used"}
    assert "all.csv: 1 of its 2 images" in dataset.report() and "left out" not in dataset.report()


def boxes_of(*shapes: np.ndarray) -> str:
    """Boxes of an imglab file, the larger the later."""
    parts = [
        "".join(f"<part name='{i}' x='{x:g}' y='{y:g}'/>" for i, (x, y) in enumerate(shape) if np.isfinite(x))
        for shape in shapes
    ]
    return "".join(f"<box width='{i}' height='1'>{part}</box>" for i, part in enumerate(parts, 1))


def test_each_object_of_an_image_is_a_sample(tmp_path: Path) -> None:
    partial = np.vstack([SQUARE[:3], [[np.nan, np.nan]]])
    for stem in ("a", "b", "c"):
        add_image(tmp_path / f"{stem}.png")
    (tmp_path / "all.xml").write_text(
        f"<dataset><image file='a.png'>{boxes_of(partial, SQUARE + 1, SQUARE)}</image>"
        f"<image file='b.png'>{boxes_of(SQUARE)}</image><image file='c.png'>{boxes_of(SQUARE + 1, partial)}</image>"
        "</dataset>"
    )
    dataset = load_folder(tmp_path)
    assert names(dataset) == ["a", "a#2", "b", "c", "c#2"]
    np.testing.assert_array_equal(dataset[1].landmarks.points, SQUARE + 1)
    assert {sample.image for sample in dataset[:2]} == {tmp_path / "a.png"}
    assert dataset[3].landmarks.missing.sum() == 1  # the largest object is kept in any case
    assert reasons(dataset) == {
        "a#3": "one of several objects in an image lacks landmarks: 1 of 4; place them or delete the object, in all.xml"
    }
    assert "2 images hold 4 objects, each a sample, such as a#2 (a.png, c.png)" in dataset.report()
    write_landmarks(tmp_path / "a.pts", SQUARE)
    assert names(load_folder(tmp_path)) == ["a", "b", "c", "c#2"]


def test_an_entry_s_path_decides_between_images_of_one_name(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        add_image(tmp_path / folder / "a.png")
    write_collection(tmp_path / "all.csv", {"two/a.png": Landmarks(SQUARE), "a.png": Landmarks(SQUARE + 1)})
    dataset = load_folder(tmp_path, recursive=True)
    assert names(dataset) == ["two/a"]
    np.testing.assert_array_equal(dataset[0].landmarks.points, SQUARE)
    assert reasons(dataset)["all.csv"].startswith("1 of its 2 images is not in the folder (a.png)")


def test_recursive_or_not(tmp_path: Path) -> None:
    add_pair(tmp_path, "a")
    (tmp_path / "sub").mkdir()
    add_pair(tmp_path / "sub", "a")
    assert names(load_folder(tmp_path)) == ["a"]
    assert names(load_folder(tmp_path, recursive=True)) == ["a", "sub/a"]


def test_hidden_files_are_passed_over(tmp_path: Path) -> None:
    add_pair(tmp_path, "a")
    (tmp_path / "._a.png").write_bytes(b"resource fork of a Mac")
    (tmp_path / ".cache").mkdir()
    add_pair(tmp_path / ".cache", "b")
    dataset = load_folder(tmp_path, recursive=True)
    assert names(dataset) == ["a"]
    assert dataset.left_out == ()


@pytest.mark.parametrize("pattern", ["01-*", "01-?.png"])
def test_a_pattern_leaves_no_trace_of_the_others(tmp_path: Path, pattern: str) -> None:
    for stem in ("01-1", "01-2", "02-1"):
        add_pair(tmp_path, stem)
    (tmp_path / "02-1.pts").write_text("junk")
    dataset = load_folder(tmp_path, pattern)
    assert names(dataset) == ["01-1", "01-2"]
    assert dataset.left_out == ()


def test_progress_goes_to_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add_pair(tmp_path, "a")
    assert len(load_folder(tmp_path, progress=True)) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "1/1 landmark files" in err


# What is left out ----------------------------------------------------------------------------------


def test_every_reason_is_told(tmp_path: Path) -> None:
    for stem in ("a", "b"):
        add_pair(tmp_path, stem)
    add_pair(tmp_path, "few", SQUARE[:3])
    add_image(tmp_path / "lonely.png")
    write_landmarks(tmp_path / "orphan.pts", SQUARE)
    write_landmarks(tmp_path / "orphan2.csv", SQUARE)
    add_pair(tmp_path, "broken")
    (tmp_path / "broken.pts").write_text("{\n1 1\n")
    (tmp_path / "noise.jpg").write_bytes(b"no image at all")
    write_asf(tmp_path / "noise.asf", "noise.jpg")
    (tmp_path / "settings.json").write_text("{}")
    dataset = load_folder(tmp_path)
    assert names(dataset) == ["a", "b"]
    told = reasons(dataset)
    assert told["few.pts"] == "3 landmarks where most have 4: those of few"
    assert told["lonely.png"] == "the image has no landmarks"
    assert told["orphan.pts"] == told["orphan2.csv"] == "no image has its name"
    assert told["broken.pts"].startswith("the landmarks cannot be read: ")
    assert "no '}' after its points" in told["broken.pts"]
    assert told["noise.asf"].startswith("its image cannot be read: ")
    assert told["settings.json"].startswith("the landmarks cannot be read: ")
    # broken.png and noise.jpg are not listed besides: their landmark files say what is wrong.
    assert set(told) == {
        *("few.pts", "lonely.png", "orphan.pts", "orphan2.csv", "broken.pts"),
        *("noise.asf", "settings.json"),
    }


def test_the_preferred_file_is_used_and_the_other_told(tmp_path: Path) -> None:
    add_pair(tmp_path, "a")
    write_landmarks(tmp_path / "a.ljson", SQUARE + 1)
    write_collection(tmp_path / "all.csv", {"a.png": Landmarks(SQUARE + 2)})
    dataset = load_folder(tmp_path)
    np.testing.assert_array_equal(dataset[0].landmarks.points, SQUARE)
    told = "another landmark file takes precedence: a.pts is used"
    assert reasons(dataset) == {"a.ljson": told, "all.csv": told}


def test_an_unreadable_preferred_file_gives_way_to_the_next(tmp_path: Path) -> None:
    add_pair(tmp_path, "a", suffix=".ljson")
    (tmp_path / "a.pts").write_text("junk")
    dataset = load_folder(tmp_path)
    np.testing.assert_array_equal(dataset[0].landmarks.points, SQUARE)
    assert list(reasons(dataset)) == ["a.pts"]


def test_two_images_of_one_stem(tmp_path: Path) -> None:
    add_pair(tmp_path, "a")
    add_image(tmp_path / "a.jpg")
    dataset = load_folder(tmp_path)
    assert dataset[0].image == tmp_path / "a.png"
    assert reasons(dataset) == {"a.jpg": "another image has the same name: a.png is used"}


def test_of_two_images_of_one_stem_the_one_with_landmarks_is_taken(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    add_image(tmp_path / "a.jpg")
    write_collection(tmp_path / "all.csv", {"a.jpg": Landmarks(SQUARE)})
    assert load_folder(tmp_path)[0].image == tmp_path / "a.jpg"


def test_images_of_the_folder_above_are_said_to_be_those(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "read-me.txt").write_text("hello")
    with pytest.raises(
        LandmarkError, match=r"notes: no images in this folder; of the images in .*, none has landmarks here"
    ):
        load_folder(tmp_path / "notes")


def test_missing_folder_no_images_no_pairs(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="does not exist: name the folder"):
        load_folder(tmp_path / "no")
    with pytest.raises(ImageError, match=r"contains no image \(.*\.png.*\): name another folder"):
        load_folder(tmp_path)
    add_image(tmp_path / "a.png")
    with pytest.raises(ImageError, match="is a file, not a folder"):
        load_folder(tmp_path / "a.png")
    with pytest.raises(ImageError, match=r"no image like 'b\*': its images are a\.png\. Change"):
        load_folder(tmp_path, "b*")
    with pytest.raises(LandmarkError, match=r"its only image has no landmarks \(a\.png\)\. Add a file such as a\.pts"):
        load_folder(tmp_path)
    (tmp_path / "a.pts").write_text("junk")
    with pytest.raises(LandmarkError, match=r"The first fault: .*a\.pts: there is no '\{'"):
        load_folder(tmp_path)
    (tmp_path / "a.csv").write_text("id,X1,Y1\n")
    with pytest.raises(
        LandmarkError, match=r"The first faults: .*a\.csv: there are no columns.*a\.pts: there is no '\{'"
    ):
        load_folder(tmp_path)


NTS = "1 4 2 0 dim=2\n1.0 1.0 5.0 1.0 5.0 4.0 1.0 4.0\n"


@pytest.mark.parametrize("name", ["a.dta", "a.fit3", "points.txt", "all.dat"])
def test_files_in_an_unknown_format_are_named_with_the_formats_that_can_be_read(tmp_path: Path, name: str) -> None:
    add_image(tmp_path / "a.png")
    (tmp_path / name).write_bytes(b"\0Iout\xff" if name == "a.fit3" else NTS.encode())
    (tmp_path / "README.txt").write_text("These 12 images are ours. Do not copy them.")
    with pytest.raises(LandmarkError, match=rf"unknown format: {name}\. Convert them to one of \.pts, "):
        load_folder(tmp_path)
    add_pair(tmp_path, "b")
    told = reasons(load_folder(tmp_path))
    assert told.keys() == {"a.png", name}
    assert told[name].startswith("unknown format; landmarks are read from .pts, ")


def test_other_files_are_not_named_if_every_image_has_landmarks(tmp_path: Path) -> None:
    add_pair(tmp_path, "a")
    (tmp_path / "a.dta").write_text(NTS)
    assert load_folder(tmp_path).left_out == ()


def test_images_in_subfolders_only_offer_recursive(tmp_path: Path) -> None:
    for stem in ("a", "b"):
        add_pair(tmp_path / "one", stem)
    with pytest.raises(ImageError, match=r"subfolders only \(one/a\.png, one/b\.png\): give .*recursive=True"):
        load_folder(tmp_path)
    assert len(load_folder(tmp_path, recursive=True)) == 2


def test_files_without_a_readable_image_are_named_by_their_types(tmp_path: Path) -> None:
    for stem in ("a", "b"):
        (tmp_path / f"{stem}.psd").write_bytes(b"x")
        write_landmarks(tmp_path / f"{stem}.pts", SQUARE)
    with pytest.raises(ImageError, match=r"only files of type \.psd \(2\), \.pts \(2\): convert the images"):
        load_folder(tmp_path)


def test_landmark_files_with_other_names_than_the_images_are_listed(tmp_path: Path) -> None:
    for i in range(9):
        add_image(tmp_path / f"img{i}.png")
        write_landmarks(tmp_path / f"img{i}_points.pts", SQUARE)
    with pytest.raises(LandmarkError) as caught:
        load_folder(tmp_path)
    message = str(caught.value)
    assert "none of the 9 images has landmarks (img0.png, img1.png, img2.png and 6 more)" in message
    assert "without an image: img0_points.pts, img1_points.pts" in message
    assert "and 3 more. Name each after its image, as in img0.pts" in message


def test_landmark_files_in_a_subfolder_are_found(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    (tmp_path / "marks").mkdir()
    write_landmarks(tmp_path / "marks" / "a.pts", SQUARE)
    with pytest.raises(LandmarkError, match=r"in other folders \(marks/a\.pts\): put each beside its image"):
        load_folder(tmp_path)
    (tmp_path / "images").mkdir()
    (tmp_path / "a.png").rename(tmp_path / "images" / "a.png")
    with pytest.raises(LandmarkError, match=r"in other folders \(marks/a\.pts\): put each beside its image"):
        load_folder(tmp_path, recursive=True)


def test_images_in_an_unsupported_format_are_named(tmp_path: Path) -> None:
    for stem in ("a", "b"):
        add_pair(tmp_path, stem)
    (tmp_path / "b.png").rename(tmp_path / "b.psd")
    told = reasons(load_folder(tmp_path))
    assert told == {
        "b.pts": "no image has its name",
        "b.psd": "unsupported image format; convert it to .png, .tif or .jpg",
    }


def test_a_table_that_names_other_images_is_quoted(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png")
    write_collection(tmp_path / "all.csv", {"old/b.png": Landmarks(SQUARE)})
    with pytest.raises(LandmarkError, match=r"all\.csv: it names images that do not exist: old/b\.png\. Correct"):
        load_folder(tmp_path)


# Samples and data sets -----------------------------------------------------------------------------


def test_a_sample_reads_its_image_or_has_it(tmp_path: Path) -> None:
    marks = Landmarks(SQUARE)
    path = add_image(tmp_path / "a.png", 9)
    assert Sample("a", path, marks).read_image()[0, 0].tolist() == [9, 9, 9]
    array = np.zeros((2, 2, 3), np.uint8)
    assert Sample("b", array, marks).read_image() is array


def test_slices_and_selection() -> None:
    samples = tuple(Sample(name, Path(name), Landmarks(SQUARE)) for name in ("01-1", "01-2", "02-1"))
    dataset = Dataset(samples, (UnusedFile(Path("x"), "why"),), "here")
    assert names(dataset[1:]) == ["01-2", "02-1"]
    assert dataset[1:].left_out == dataset.left_out
    assert dataset[-1].name == "02-1"
    assert names(dataset.select("01-*")) == ["01-1", "01-2"]
    assert names(dataset.select(["02-?", "*-2"])) == ["01-2", "02-1"]
    assert names(dataset.select(lambda sample: sample.name.endswith("1"))) == ["01-1", "02-1"]
    with pytest.raises(LiaamError, match="no sample of here matches '9': the names are like 01-1, 01-2, 02-1"):
        dataset.select("9")
    with pytest.raises(LiaamError, match=r"no sample of here matches '9', '8\*': the names"):
        dataset.select(["9", "8*"])
    assert repr(dataset) == "Dataset(3 samples, 1 left out, source='here')"


def test_report(tmp_path: Path) -> None:
    for stem in ("a", "b", "c"):
        add_pair(tmp_path, stem)
    write_landmarks(tmp_path / "c.pts", np.where(np.arange(4)[:, None] == 2, np.nan, SQUARE))
    for stem in ("p", "q", "r", "s"):
        add_image(tmp_path / f"{stem}.png")
    add_pair(tmp_path, "few", SQUARE[:3])
    assert load_folder(tmp_path).report().splitlines() == [
        f"3 samples from {tmp_path}",
        "4 landmarks in each sample, 1 missing in total",
        "landmark files by format: 300-W points (.pts): 3",
        "left out 1: 3 landmarks where most have 4 (few.pts)",
        "  first: those of few",
        "left out 4: the image has no landmarks (p.png, q.png, r.png, s.png)",
    ]
    assert Dataset(()).report() == "0 samples"


# Real folders --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "n_samples", "n_points", "title"),
    [
        ("imm", 132, 58, "300-W points (.pts): 132"),
        ("imm-frontal", 60, 73, "AAM-API shape (.asf): 60"),
        ("one-person", 26, 58, "300-W points (.pts): 26"),
        ("london", 60, 189, "WebMorph template (.tem): 60"),
    ],
)
def test_real_folders(shared_data: Path, folder: str, n_samples: int, n_points: int, title: str) -> None:
    dataset = load_folder(shared_data / folder)
    assert len(dataset) == n_samples
    assert {len(sample.landmarks) for sample in dataset} == {n_points}
    assert dataset.left_out == ()
    assert title in dataset.report()


def test_real_images_without_landmarks(shared_data: Path) -> None:
    with pytest.raises(LandmarkError, match="none of the 12 images has landmarks"):
        load_folder(shared_data / "illuminants")


def test_an_image_whose_landmarks_cannot_be_read_is_left_out_once(tmp_path: Path) -> None:
    add_pair(tmp_path, "good")
    add_image(tmp_path / "bare.png")
    add_image(tmp_path / "junk.png")
    (tmp_path / "junk.pts").write_text("nothing of the kind")
    (tmp_path / "text.jpg").write_text("no image")
    write_asf(tmp_path / "text.asf", "text.jpg")
    dataset = load_folder(tmp_path)
    assert names(dataset) == ["good"]
    assert [left.path.name for left in dataset.left_out] == ["bare.png", "junk.pts", "text.asf"]
    assert reasons(dataset)["bare.png"] == "the image has no landmarks"


def test_two_names_of_one_image_in_a_file_are_named(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    (tmp_path / "t.csv").write_text("image,x,y\nold/a.png,5,6\nold/a.png,7,8\na.png,1,2\na.png,3,4\n")
    data = load_folder(tmp_path)
    assert [sample.landmarks.points.tolist() for sample in data] == [[[1, 2], [3, 4]]]
    assert "'old/a.png' and 'a.png' both name a.png; the landmarks of the second are used" in data.report()


@pytest.mark.parametrize(
    ("folder", "names", "sides"),
    [
        ("left", ["a", "b"], ["left", "left"]),
        ("Right", ["a", "b"], ["right", "right"]),
        ("L", ["a", "b"], ["", ""]),
        ("left", ["a_right", "b_left"], ["right", "left"]),
    ],
)
def test_a_folder_may_be_called_after_a_side(tmp_path, folder, names, sides):
    (tmp_path / folder).mkdir()
    for name in names:
        write_image(tmp_path / folder / f"{name}.png", np.zeros((20, 20, 3), np.uint8))
        write_landmarks(tmp_path / folder / f"{name}.pts", SQUARE)
    assert [sample.side for sample in load_folder(tmp_path / folder)] == sides


def test_a_table_without_landmarks_states_sides(tmp_path):
    for name in "abc":
        add_image(tmp_path / f"{name}.png")
    marks = "".join(f"LM=2\n1 2\n3 4\nIMAGE={name}.png\n" for name in "abc")
    (tmp_path / "marks.tps").write_text(marks)
    (tmp_path / "own.csv").write_text("Photo,fly,Side\na.png,1,Left\nb,1,R\n")
    data = load_folder(tmp_path)
    assert [sample.side for sample in data] == ["left", "right", ""]
    assert "sides are those of the table own.csv" in data.report()
    assert not data.left_out
    # A landmark file that another takes precedence over says the sides all the same.
    table = "".join(f"{name}.png,{x},{x + 1},left\n" for name in "abc" for x in (1, 3))
    (tmp_path / "own.csv").write_text(f"image,x,y,side\n{table}")
    assert [sample.side for sample in load_folder(tmp_path)] == ["left"] * 3


def test_images_in_subfolders_of_landmarks_are_named(tmp_path):
    (tmp_path / "wings" / "left").mkdir(parents=True)
    add_image(tmp_path / "other.png")  # beside the folder, and not of it
    add_image(tmp_path / "wings" / "left" / "a.png")
    (tmp_path / "wings" / "marks.tps").write_text("LM=2\n1 2\n3 4\nIMAGE=a.png\n")
    with pytest.raises(ImageError, match=r"images in its subfolders only \(left/a\.png\): give '.*wings/\*\*'"):
        load_folder(tmp_path / "wings")
    assert [sample.side for sample in load_folder(tmp_path / "wings", recursive=True)] == ["left"]
