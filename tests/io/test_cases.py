"""Files from public reports (``../shared/cases``, one row of its README each) are read with the right values."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from liaam import fit, train
from liaam.datasets import Dataset, load_folder
from liaam.datasets.label_faults import find_label_faults
from liaam.errors import ImageError, LandmarkError, LiaamError
from liaam.fitting.search.starts import read_start
from liaam.io import Landmarks, read_landmarks, write_landmarks
from liaam.io.landmarks import FORMATS, Reading
from liaam.io.landmarks.formats import Format
from liaam.morphometry import read_specimens
from liaam.training.entries import read_entries, with_all_landmarks
from liaam.training.objects import folds_of

FIRST = [[158.51, 78.95], [145.49, 115.31], [98.35, 123.51], [56.11, 111.48]]
FIRST += [[41.39, 87.98], [65.54, 57.71], [98.61, 40.88], [137.25, 53.31]]
"""The landmarks of img00."""

ROUND = 1.0
"""Programs that round to whole pixels."""


@pytest.fixture
def cases(shared_data: Path) -> Path:
    folder = Path(shared_data).parent / "cases"
    if not folder.is_dir():
        pytest.skip("the cases are absent")
    return folder


RIGHT = [
    ("03-tps-empty-scale", 10, "there is no scale.*: img04.png"),
    ("07-tps-curves", 10, ""),
    ("10-tps-other-extension", 10, "named with another extension in the landmark file: img00.jpg"),
    ("12-tps-cp1251-names", 10, "named in another spelling"),
    ("17-tps-cr-only", 10, ""),
    ("18-nts", 10, r"\(\.nts\): 10"),
    ("21-dlib-ignored-box", 10, ""),
    ("24-coco-skeleton-from-0", 10, ""),
    ("25-coco-labelstudio-paths", 10, ""),
    ("26-coco-large-unlabelled-person", 10, ""),
    ("28-coco-scale-bar-category", 10, "left out the category 'scale'.*--category.*: img00.png"),
    ("29-coco-two-categories-larger", 10, "left out the category 'scale'.*--category.*: img00.png"),
    ("30-coco-names-count", 10, "without names.*9 names for 8"),
    ("33-labelme-json", 10, "LabelMe"),
    ("34-labelstudio-json", 10, "Label Studio"),
    ("35-csv-specimen-landmark", 10, ""),
    ("36-csv-imagej-results", 10, ""),
    ("37-csv-wide-mlmorph", 10, "one row an image"),
    ("38-csv-deeplabcut", 10, "DeepLabCut"),
    ("39-csv-excel-german", 10, ""),
    ("40-csv-excel-sep", 10, ""),
    ("42-csv-utf16", 10, ""),
    ("44-pts-crlf-odd-header", 10, ""),
    ("45-pts-zero-zero-missing", 10, ""),
    ("47-pts-comma-sep", 10, ""),
    ("51-txt-wflw", 10, ""),
    ("56-pts-one-zero", 10, ""),
    ("58-coco-train-unlabelled", 10, ""),
    ("59-train-missing", 10, "1 missing in total"),
    ("66-webp-folder", 10, ""),
    ("80-tps-nfd-names", 10, ""),
    ("82-case-mismatch", 10, ""),
    ("87-coco-train-val", 10, ""),
    ("89-cvat-xml", 10, "CVAT"),
    ("92-csv-rows-shuffled", 10, "in another order, and are taken by name"),
    ("93-csv-names-order-differs", 10, "in another order, and are taken by name: img04"),
    ("94-ljson-v1", 10, ""),
    ("99-tps-append-partial", 9, ""),
    ("A1-coco-names-order-two-files", 10, "in another order, and are taken by name: img05"),
    ("C1-two-formats-disagree", 10, "disagree in .pts and all.tps.*: img00.png"),
    ("C4-coco-orphan-annotation", 10, "left out annotation 99.*no image 777"),
    ("G1-coco-case", 10, "named in another case in the landmark file: img00.JPG"),
    ("G2-csv-case", 10, "named in another case in the landmark file: img00.JPG"),
]


TOOLS = [
    ("105-tiff-channels-as-pages", 10, ""),
    ("106-tiff-thumbnail-first", 10, ""),
    ("109-napari-points", 10, "napari"),
    ("110-via-csv", 10, "VGG Image Annotator"),
    ("111-yolo-pose", 10, "YOLO"),
    ("113-labelstudio-csv", 10, "Label Studio"),
    ("114-labelstudio-relations", 20, "Label Studio"),
    ("116-xlsx-beside-images", 10, "xlsx"),
    ("117-tps-txt-ending", 10, "tpsDig"),
    ("118-old-copy-of-the-file", 10, r"disagree in 'all.tps' and 'all \(1\).tps'; remove one \('all.tps' is used\)"),
    ("122-makesense-points-csv", 10, "makesense"),
    ("123-geojson-points", 10, "GeoJSON"),
    ("124-labelme-points-in-boxes", 20, "LabelMe"),
]
FIRST_OF_TOOLS = (125.48, 61.96)
"""The first landmark of img00 in the cases from 101 on, but for those of two objects an image."""


@pytest.mark.parametrize(("name", "count", "said"), TOOLS, ids=[name for name, *_ in TOOLS])
def test_exports_of_tools_are_read(cases: Path, name: str, count: int, said: str) -> None:
    data = load_folder(cases / name / "data")
    assert len(data) == count
    assert {len(sample.landmarks) for sample in data} == {8}
    assert_matches(said, data)
    if count == 10:
        first = data[0].landmarks
        first = first.in_order_of([f"p{i}" for i in range(8)]) if "p0" in first.names else first
        np.testing.assert_allclose(first.points[0], FIRST_OF_TOOLS, atol=0.5)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("115-json-of-other-tools/data/darwin", "an export of Darwin"),
        ("115-json-of-other-tools/data/encord", "an export of Encord"),
        ("115-json-of-other-tools/data/createml", "an export of CreateML"),
        ("115-json-of-other-tools/data/voc", "an export of labelImg"),
    ],
)
def test_tools_whose_exports_are_not_read_are_named(cases: Path, name: str, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        load_folder(cases / name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("107-tiff-two-photos-in-a-file/data", "holds 2 pictures"),
        ("119-tiff-not-damaged/data/jpeg2000", "compressed by JPEG 2000, which is not read"),
        ("119-tiff-not-damaged/data/fiveband", "has 5 bands"),
        ("119-tiff-not-damaged/data/bigendian", "a BigTIFF of big-endian order, which is not read"),
    ],
)
def test_sound_tiffs_that_are_not_read_are_not_called_damaged(cases: Path, name: str, words: str) -> None:
    with pytest.raises(ImageError, match=words) as caught:
        load_folder(cases / name)[0].read_image()
    assert "is damaged" not in str(caught.value)


def test_pages_that_are_colours_are_read_as_colours(cases: Path) -> None:
    image = load_folder(cases / "105-tiff-channels-as-pages/data")[0].read_image()
    assert image[62, 125].tolist() == [220, 60, 50]


@pytest.mark.parametrize(("name", "count", "said"), RIGHT, ids=[name for name, *_ in RIGHT])
def test_a_folder_is_read_rightly(cases: Path, name: str, count: int, said: str) -> None:
    data = load_folder(cases / name)
    assert len(data) == count
    assert_matches(said, data)
    np.testing.assert_allclose(in_usual_order(data), FIRST, atol=ROUND)


def in_usual_order(data: Dataset) -> np.ndarray:
    first = data[0].landmarks
    return first.in_order_of([f"p{i}" for i in range(8)]).points if "p0" in first.names else first.points


def assert_matches(said: str, data: Dataset) -> None:
    import re

    assert re.search(said, data.report()), data.report()


SHIFTED = [
    ("04-tps-two-specimens-per-image", Reading(), 20, (76.3295, 55.5275), "each a sample"),
    ("06-tps-y-down", Reading(y_down=True), 10, (158.51, 78.95), ""),
    ("31-coco-exif-unrotated", Reading(), 10, (80.05, 158.51), "turned along: img00.jpg"),
    ("32-tps-exif-unrotated", Reading(), 10, (158.51, 118.95), "nothing says whether.*--stored-orientation"),
    ("32-tps-exif-unrotated", Reading(stored=True), 10, (80.05, 158.51), "turned along: img00.jpg"),
    ("53-ljson-two-groups", Reading(category="PTS"), 10, (158.51, 78.95), ""),
    ("19-dlib-natural-order", Reading(), 10, (20, 30), ""),
    ("E1-coco-images-enlarged", Reading(), 10, (317.52, 158.40), "another size of the image, and are scaled along"),
]


@pytest.mark.parametrize(("name", "reading", "count", "point", "said"), SHIFTED)
def test_positions_are_converted(cases: Path, name: str, reading: Reading, count: int, point: tuple, said: str) -> None:
    data = load_folder(cases / name, reading=reading)
    assert len(data) == count
    assert_matches(said, data)
    np.testing.assert_allclose(data[0].landmarks.points[0], point, atol=0.01)


def test_specimens_of_an_image_are_named_by_their_ids(cases: Path) -> None:
    names = [sample.name for sample in load_folder(cases / "04-tps-two-specimens-per-image")]
    assert names[:3] == ["img00#0", "img00#1", "img01#2"]


def test_categories_and_groups_are_chosen(cases: Path) -> None:
    bars = load_folder(cases / "28-coco-scale-bar-category", reading=Reading(category="scale"))
    assert {len(sample.landmarks) for sample in bars} == {2}
    pupils = load_folder(cases / "53-ljson-two-groups", reading=Reading(category="pupils"))
    assert {len(sample.landmarks) for sample in pupils} == {2}
    with pytest.raises(LandmarkError, match=r"\(PTS, pupils\): choose one of them with --category"):
        load_folder(cases / "53-ljson-two-groups")


def test_files_whose_names_match_no_image_are_named(cases: Path) -> None:
    with pytest.raises(LandmarkError, match=r"without an image: img00_landmarks\.pts.*Name each after its image"):
        load_folder(cases / "D5-pts-suffix-names")


STRICT = ["03-tps-empty-scale", "30-coco-names-count", "C1-two-formats-disagree", "C4-coco-orphan-annotation"]


@pytest.mark.parametrize("name", STRICT)
def test_strict_refuses(cases: Path, name: str) -> None:
    with pytest.raises(LandmarkError):
        load_folder(cases / name, reading=Reading(strict=True))


def test_names_in_a_start_decide(cases: Path) -> None:
    start = read_landmarks(cases / "93-csv-names-order-differs/p.csv", image_name="img04.png")
    assert start.names != tuple(sorted(start.names))
    usual = start.in_order_of(sorted(start.names))
    assert usual.names == tuple(f"p{i}" for i in range(8))


MEASURED = [
    ("54-measure-long-csv/points.csv", 10),
    ("60-measure-missing-landmark/all.tps", 10),
    ("61-measure-tps-without-images/all.tps", 10),
    ("63-measure-nts/all.nts", 10),
    ("64-measure-id-names/all.tps", 10),
    ("96-scalebar-missing/all.tps", 10),
    ("F1-measure-one-bad-record/all.tps", 10),
]


@pytest.mark.parametrize(("name", "count"), MEASURED)
def test_specimens_are_read_without_images(cases: Path, name: str, count: int) -> None:
    specimens = read_specimens(cases / name, lambda line: None)
    assert len(specimens) == count
    steps = np.linalg.norm(np.diff(specimens[0].points[:4], axis=0), axis=1)
    np.testing.assert_allclose(steps, np.linalg.norm(np.diff(FIRST[:4], axis=0), axis=1), atol=0.01)


def test_an_image_with_a_missing_landmark_is_trained_on(cases: Path) -> None:
    entries = read_entries(load_folder(cases / "59-train-missing")).entries
    assert len(entries) == 10
    assert sum(entry.known is not None for entry in entries) == 1


def test_landmarks_missing_in_each_image_are_placed_by_the_others(cases: Path) -> None:
    data = read_entries(load_folder(cases / "G5-missing-in-each"))
    entries = with_all_landmarks(data, folds_of(data.names)).entries
    assert len(entries) == 10
    truth = load_folder(cases / "07-tps-curves")[0].landmarks.points
    assert np.abs(entries[0].points[0] - truth[0]).max() < 8


FAULTS = {
    "06-tps-y-down": [],
    "07-tps-curves": [],
    "45-pts-zero-zero-missing": [("img02", "stray", (0, 7)), ("img05", "stray", (0, 7))],
    "56-pts-one-zero": [("img02", "stray", (0,))],
    "93-csv-names-order-differs": [],
    "C2-left-right-wings": [("img04", "mirrored", tuple(range(10)))],
    "C3-tps-half-y-down": [("img07", "upside-down", tuple(range(10)))],
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_landmarks_are_found(cases: Path, name: str) -> None:
    data = load_folder(cases / name)
    faults = find_label_faults([sample.landmarks.points for sample in data])
    assert [(data[fault.picture].name, fault.kind, fault.points) for fault in faults] == FAULTS[name]
    assert not any(fault.is_order for fault in faults)


def test_heic_names_the_extra(cases: Path) -> None:
    try:
        import pillow_heif  # type: ignore # noqa: F401
    except ImportError:
        with pytest.raises(LiaamError, match=r"heic"):
            load_folder(cases / "67-heic-folder")[0].read_image()
        return
    with warnings.catch_warnings():
        assert load_folder(cases / "67-heic-folder")[0].read_image().shape[2] == 3


def test_the_documentation_lists_the_formats() -> None:
    text = (Path(__file__).parents[2] / "docs/reference/formats.md").read_text(encoding="utf-8")
    table = text.partition("<!-- formats")[2].partition("<!-- end of formats")[0].splitlines()
    assert [line for line in table if line.startswith("| ")][1:] == [row_of(form) for form in FORMATS]


def row_of(form: Format) -> str:
    suffixes = ", ".join(f"`{suffix}`" for suffix in form.suffixes)
    also = "yes, also of many images" if form.text_of_many else "yes"
    written = also if form.text else "yes, of many images" if form.text_of_many else "–"
    cells = form.title, suffixes, "yes, of many images" if form.many else "yes", written, form.origin
    return f"| {' | '.join(cells)} | {'yes' if form.contours else '–'} | {'yes' if form.names else '–'} |"


def test_a_start_whose_names_are_in_another_order_is_taken_by_name(cases: Path, tmp_path: Path) -> None:
    folder, order = cases / "B3-init-names-order", [3, 0, 7, 1, 6, 2, 5, 4]
    data = load_folder(folder)
    truth = data[0].landmarks
    model = train(data, leave_out=False, copies=0)
    write_landmarks(tmp_path / "start.csv", Landmarks(truth.points[order], names=tuple(truth.names[i] for i in order)))
    start = read_start(str(tmp_path / "start.csv"), folder / "img00.png", (200, 160))
    result = fit(model, folder / "img00.png", start)
    assert np.abs(result.landmarks - truth.points).max() < 2
