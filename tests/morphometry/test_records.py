"""Records of images: names that tell all apart, objects and replicates."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.io.landmarks.matching import unique_names
from liaam.morphometry import Specimen, alike, exchanged_landmarks, measure, measurement_error, read_specimens
from liaam.morphometry.records import Record, objects_of_records, without_copies
from setups import growth

LEAF = np.array([[0.0, 0], [30, 5], [45, 30], [20, 50], [5, 30]])


def coco(images: dict[str, list[np.ndarray]]) -> str:
    annotations = [
        {
            "id": len(images) * j + i,
            "image_id": i,
            "category_id": 1,
            "keypoints": [value for x, y in points for value in (x, y, 2)],
            "bbox": [*points.min(axis=0), *np.ptp(points, axis=0)],
        }
        for i, every in enumerate(images.values())
        for j, points in enumerate(every)
    ]
    names = [f"p{i}" for i in range(len(LEAF))]
    listed = [{"id": i, "file_name": name} for i, name in enumerate(images)]
    return json.dumps(
        {"images": listed, "annotations": annotations, "categories": [{"id": 1, "name": "leaf", "keypoints": names}]}
    )


def errors_of(folder: Path) -> dict[str, list]:
    specimens, _ = alike(read_specimens(folder, lambda line: None, replicates=True))
    return measurement_error(specimens, measure(specimens, "distance:1-2"), "image")


@pytest.mark.parametrize("offset", [0, -160])  # such as that of a file whose y counts from below
def test_objects_of_an_image_are_matched_between_files_by_their_places(tmp_path: Path, rng, offset: int) -> None:
    for file in ("first", "second"):
        images = {}
        for i in range(6):
            both = [LEAF * (1 + 0.1 * i) + rng.normal(0, 0.1, LEAF.shape) + at for at in ([10, 10], [150, 90])]
            if file == "second":
                both = [both[1] + [0, offset], both[0] + [0, offset]]
            images[f"img{i}.png"] = both
        (tmp_path / f"{file}.json").write_text(coco(images))
    specimens = read_specimens(tmp_path, replicates=True)
    assert len({specimen.name for specimen in specimens}) == 24
    errors = errors_of(tmp_path)
    assert (errors["specimens"][0], errors["replicates"][0]) == (12, 24)
    assert errors["sd"][1] < 0.3


def test_objects_that_lie_apart_are_no_replicates(tmp_path: Path) -> None:
    (tmp_path / "all.json").write_text(coco({f"i{i}.png": [LEAF, LEAF + np.array([100, i])] for i in range(4)}))
    with pytest.raises(LiaamError, match=r"no specimen has replicates, as all names differ \(i0, i0#2, i1"):
        errors_of(tmp_path)


def test_records_that_lie_on_each_other_are_replicates(tmp_path: Path, rng) -> None:
    noisy = {f"i{i}.png": [LEAF + rng.normal(0, 1, LEAF.shape) for _ in range(3)] for i in range(4)}
    (tmp_path / "all.json").write_text(coco(noisy))
    assert (errors_of(tmp_path)["specimens"][0], errors_of(tmp_path)["replicates"][0]) == (4, 12)


def test_marks_in_peoples_names_mean_nothing(tmp_path: Path) -> None:
    rows = [f"wing#{i}.png,{x},{y + i}" for i in range(4) for x, y in LEAF]
    (tmp_path / "all.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    with pytest.raises(LiaamError, match="no specimen has replicates"):
        errors_of(tmp_path)


def test_images_of_one_name_in_several_folders_are_several(tmp_path: Path) -> None:
    rows = [f"{folder}/w{i}.png,{x},{y}" for folder in ("left", "right") for i in range(2) for x, y in LEAF]
    (tmp_path / "all.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    names = [specimen.name for specimen in read_specimens(tmp_path / "all.csv")]
    assert names == ["left/w0", "left/w1", "right/w0", "right/w1"]


def test_files_that_name_one_image_in_different_folders_are_named(tmp_path: Path) -> None:
    for file, folder in (("a", "left"), ("b", "right")):
        rows = [f"/data/{folder}/w{i}.png,{x},{y}" for i in range(2) for x, y in LEAF]
        (tmp_path / f"{file}.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    said: list[str] = []
    read_specimens(tmp_path, said.append, replicates=True)
    assert said == ["images of one name in different folders are taken for the same: left in a.csv, right in b.csv"]


@pytest.mark.parametrize(
    ("entries", "names"),
    [
        (["a/x.png", "a/y.png"], ["x", "y"]),
        (["a/x.png", "b/x.png", "b/y.png"], ["a/x", "b/x", "b/y"]),
        (["c:\\d\\a\\x.png", "c:\\d\\b\\x.png"], ["a/x", "b/x"]),
        (["x.png", "x.jpg"], ["x.png", "x.jpg"]),
        (["x.png", "b/x.png"], ["x", "b/x"]),
        (["/data/upload/1/0a1b2c3d-x.png", "/data/upload/1/0a1b2c3e-x.png"], ["0a1b2c3d-x.png", "0a1b2c3e-x.png"]),
    ],
)
def test_names_have_as_much_of_the_path_as_tells_all_apart(entries: list[str], names: list[str]) -> None:
    assert list(unique_names(entries).values()) == names


@pytest.mark.parametrize("order", [[0, 1, 3, 2, 4], [4, 3, 2, 1, 0]])
def test_observers_who_number_landmarks_in_other_orders_are_named(tmp_path: Path, rng, order: list[int]) -> None:
    for file, places in (("anna", [0, 1, 2, 3, 4]), ("bert", order)):
        rows = [f"w{i}.png,{x},{y + i}" for i in range(5) for x, y in (LEAF + rng.normal(0, 0.3, LEAF.shape))[places]]
        (tmp_path / f"{file}.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    specimens = read_specimens(tmp_path, replicates=True)
    assert len({specimen.replicate_of for specimen in specimens}) == 5
    moved = [str(i + 1) for i, place in enumerate(order) if i != place]
    how = "exchanged" if len(moved) == 2 else "in different orders"
    [line] = exchanged_landmarks(specimens, "image")
    assert line.startswith(f"landmarks {', '.join(moved[:-1])} and {moved[-1]} are {how} between anna.csv and bert.csv")


def test_observers_who_agree_are_not_named(tmp_path: Path, rng) -> None:
    for file in ("anna", "bert"):
        rows = [f"w{i}.png,{x},{y + i}" for i in range(5) for x, y in LEAF + rng.normal(0, 3, LEAF.shape)]
        (tmp_path / f"{file}.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    assert exchanged_landmarks(read_specimens(tmp_path, replicates=True), "image") == []


@pytest.mark.parametrize(("suffix", "head", "row"), [("csv", "image,x,y\n", "{},{},{}\n"), ("pts", "", "")])
def test_points_at_0_0_are_named(tmp_path: Path, suffix: str, head: str, row: str) -> None:
    shapes = [LEAF + 9 + i for i in range(3)]
    shapes[1][2] = 0
    if suffix == "csv":
        rows = "".join(row.format(f"w{i}.png", x, y) for i, points in enumerate(shapes) for x, y in points)
        (tmp_path / "all.csv").write_text(head + rows)
    else:
        for i, points in enumerate(shapes):
            lines = "\n".join(f"{x} {y}" for x, y in points)
            (tmp_path / f"w{i}.pts").write_text(f"n_points: 5\n{{\n{lines}\n}}\n")
    said: list[str] = []
    read_specimens(tmp_path, said.append)
    [line] = said
    assert line.startswith("landmarks at 0, 0, which many programs write") and line.endswith(": w1 (landmark 3)")


def test_a_common_origin_is_no_missing_point(tmp_path: Path) -> None:
    rows = [f"w{i}.png,{x},{y * (1 + i)}" for i in range(3) for x, y in LEAF]
    (tmp_path / "all.csv").write_text("\n".join(["image,x,y", *rows, ""]))
    said: list[str] = []
    read_specimens(tmp_path, said.append)
    assert said == []


def test_plates_with_thousands_of_objects_are_matched_quickly() -> None:
    def work(count: int) -> None:
        side = int(count**0.5)
        at = [(100.0 * (i % side), 100.0 * (i // side)) for i in range(count)]
        records = [
            Record("plate", Specimen(f"plate#{i}", LEAF + place, file=file))
            for file in ("a.csv", "b.csv")
            for i, place in enumerate(at)
        ]
        specimens = objects_of_records(records)
        assert len({specimen.replicate_of for specimen in specimens}) == count

    assert growth(work, 400) < 24  # 8 times the objects; 64 if each is compared with each other


def test_objects_without_points_do_not_matter() -> None:
    lost = np.full(LEAF.shape, np.nan)
    records = [
        Record("a", Specimen(f"a#{i}", points, file=file))
        for file in ("x.csv", "y.csv")
        for i, points in enumerate([LEAF, lost, LEAF + 100])
    ]
    specimens = objects_of_records(records)
    assert [specimen.replicate_of for specimen in specimens[:3]] == ["a#0", "a#1", "a#2"]
    assert [specimens[3].replicate_of, specimens[5].replicate_of] == ["a#0", "a#2"]


def test_names_that_are_only_a_drive_are_kept():
    assert unique_names(["x/c:", "y/c:"]) == {"x/c:": "x/c:", "y/c:": "y/c:"}


def test_fits_to_copies_of_a_picture_are_left_out_by_name():
    points = np.array([[0.0, 0], [10, 1], [12, 9], [3, 14]])

    def fit(name, fingerprint, moved=0.0, status="converged"):
        return Specimen(name, points + moved, image=f"{name}.jpg", fingerprint=fingerprint, status=status)

    given = [fit("a", "p"), fit("b", "q"), fit("copy", "p", 0.5), fit("other", "p", 100.0), fit("bare", "")]
    by_hand = replace(fit("d", "p"), status="")  # a second observation of the picture
    again = replace(given[0], name="a#2")  # another record of the same file
    kept, left_out = without_copies([*given, by_hand, again, fit("lost", "p", status="diverged")])
    assert [each.name for each in kept] == ["a", "b", "other", "bare", "d", "a#2", "lost"]
    assert left_out == ("copy: its file is a copy of that of a, under another name; it is left out",)


def test_images_that_were_fitted_again_are_taken_from_the_table_that_may_be_used(tmp_path):
    header = "path,status,quality,x1,y1,x2,y2,x3,y3\n"
    first = "a.png,converged,1,0,0,9,2,20,3\nb.png,doubtful,1,5,5,9,2,20,3\nc.png,doubtful,1,0,0,9,2,20,3\n"
    (tmp_path / "fits.csv").write_text(header + first)
    (tmp_path / "turned.csv").write_text(f"{header}b.png,converged,1,7,7,9,2,20,3\nc.png,doubtful,1,1,1,9,2,20,3\n")
    told: list[str] = []
    found = read_specimens(tmp_path, told.append)
    assert [(each.name, each.status, each.points[0, 0]) for each in found] == [
        ("a", "converged", 0.0),
        ("b", "converged", 7.0),
        ("c", "doubtful", 0.0),
    ]
    assert told == []
