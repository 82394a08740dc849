"""Overlays: seen on any ground, with the status in colour and words, for landmarks anywhere."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.datasets import load_heads
from liaam.datasets.label_faults import find_label_faults
from liaam.drawing import ABSENT, DOUBTFUL, LANDMARK, LOST, rgb
from liaam.fitting import FitResult, FitStatus, Fitter
from liaam.plotting import enlarged, overlay, overlay_of_faults, overlay_of_fit, thumbnail
from liaam.plotting.overlays import LARGE, _lines_of_caption, _width_of_caption, caption_of, write_caption
from liaam.plotting.scales import overlay_of_scale
from liaam.scale import Bar
from liaam.scale.rulers import Ruler

SHAPE = np.array([[60.0, 60], [140, 60], [100, 100], [60, 140], [140, 140]])


@pytest.fixture(scope="module")
def fitted(head_model) -> tuple[np.ndarray, FitResult]:
    """Give an image of a head, and the fit to it."""
    sample = load_heads()[1][0]
    image = sample.read_image()
    return image, Fitter(head_model).fit(image, sample.landmarks)


def is_there(picture: np.ndarray, colour: str, most: int = 12) -> bool:
    """Return whether a picture has pixels of nearly a colour."""
    return bool((np.abs(picture.astype(int) - rgb(colour)).max(axis=2) <= most).any())


@pytest.mark.parametrize("ground", [0, 128, 255, LANDMARK, "#ffffff"])
def test_landmarks_and_ellipses_are_seen_on_any_ground(head_model, ground):
    colour = (ground,) * 3 if isinstance(ground, int) else rgb(ground)
    image = np.broadcast_to(np.array(colour, np.uint8), (200, 200, 3))
    shape = head_model.shape_model.mean
    shape = 40 + 120 * (shape - shape.min(axis=0)) / np.ptp(shape)
    plain = overlay(image, shape, head_model)
    rich = overlay(image, shape, head_model, 9.0 * np.ones((58, 1, 1)) * np.eye(2))
    before = enlarged(image)[0]
    for picture, base in ((plain, before), (rich, plain)):
        # A step of a quarter of the range of luminance is seen without effort.
        steps = np.abs((picture.astype(float) - base) @ [0.21, 0.72, 0.07])
        assert (steps > 64).sum() > 2000


def test_the_status_is_told_by_colour_and_in_words(fitted, head_model):
    image, result = fitted
    assert caption_of(result) == f"converged, quality {result.quality:.2f}"
    colours = {FitStatus.CONVERGED: LANDMARK, FitStatus.DOUBTFUL: DOUBTFUL, FitStatus.DIVERGED: LOST}
    for status, colour in colours.items():
        picture = overlay_of_fit(image, replace(result, status=status), head_model)
        assert [is_there(picture, each) for each in colours.values()] == [each == colour for each in colours.values()]
    assert caption_of(replace(result, status=FitStatus.DOUBTFUL)).endswith(": check it")
    assert caption_of(replace(result, status=FitStatus.DIVERGED)) == "failed: diverged"
    assert caption_of(replace(result, quality=np.nan)) == "converged, quality unknown"


def test_mesh_numbers_and_ellipses_are_drawn_on_request_only(fitted, head_model):
    image, result = fitted
    plain = overlay_of_fit(image, result, head_model)
    numbers = tuple(map(str, range(1, 59)))
    pictures = [
        overlay_of_fit(image, result, head_model, mesh=True),
        overlay_of_fit(image, result, head_model, ellipses=True),
        overlay_of_fit(image, result, head_model, labels=numbers),
    ]
    assert all((picture != plain).any() for picture in pictures)
    lost = replace(result, status=FitStatus.DIVERGED)  # whose ellipses mean nothing
    plain, rich = (overlay_of_fit(image, lost, head_model, ellipses=each) for each in (False, True))
    np.testing.assert_array_equal(plain, rich)


@pytest.mark.parametrize(
    "shape", [SHAPE * 0, SHAPE * 1e12, SHAPE * np.nan, SHAPE - 500], ids=["point", "far", "nan", "out"]
)
def test_landmarks_may_be_anywhere(head_model, shape):
    shape = np.resize(shape, (58, 2))
    labels = tuple(map(str, range(58)))
    picture = overlay(np.zeros((50, 70), np.uint8), shape, head_model, np.ones((58, 2, 2)), labels=labels, mesh=True)
    assert picture.shape[1] == pytest.approx(LARGE, abs=40)


def test_faults_are_red_and_described_on_a_white_ground(rng):
    shapes = [SHAPE + rng.normal(0, 0.5, SHAPE.shape) for _ in range(12)]
    shapes[3] = shapes[3][[1, 0, 2, 3, 4]]
    (fault,) = find_label_faults(shapes)
    white = np.full((200, 200, 3), 255, np.uint8)
    picture = overlay_of_faults(white, shapes[3], [fault])
    assert is_there(picture, LOST)
    assert is_there(picture, LANDMARK)
    caption = picture[-20:, : picture.shape[1] // 2]
    assert (caption < 80).mean() > 0.5  # a dark band with letters
    assert (caption > 200).any()


@pytest.mark.filterwarnings("error")
def test_missing_landmarks_are_not_drawn_with_faults(rng):
    shapes = [SHAPE + 60 + rng.normal(0, 0.5, SHAPE.shape) for _ in range(12)]
    shapes[3] = shapes[3][[1, 0, 2, 3, 4]]
    (fault,) = find_label_faults(shapes)
    white = np.full((200, 200, 3), 255, np.uint8)
    points = shapes[3].copy()
    points[4] = np.nan
    complete = overlay_of_faults(white, np.delete(shapes[3], 4, axis=0), [fault])
    np.testing.assert_array_equal(overlay_of_faults(white, points, [fault]), complete)
    points[1] = np.nan  # of the exchanged ones
    assert is_there(overlay_of_faults(white, points, [fault]), LOST)


def test_long_captions_continue_in_further_lines():
    picture = np.full((300, 200, 3), 255, np.uint8)
    text = "point 7 may be misplaced (30.4 px from where it is expected)"
    write_caption(picture, "; ".join([text] * 4), LOST)
    rows = (picture == 255).all(axis=2).all(axis=1)
    assert rows[:100].all() and not rows[-60:].any()
    lines = _lines_of_caption(text, 11, 200)
    assert " ".join(lines) == text and max(_width_of_caption(line, 11) for line in lines) <= 200
    one = np.full((300, 1200, 3), 255, np.uint8)
    write_caption(one, text, LOST)
    assert (one[:-60] == 255).all()
    narrower = np.full((300, 520, 3), 255, np.uint8)  # of smaller letters, in one line
    write_caption(narrower, text, LOST)
    assert (narrower[:-25] == 255).all()


def test_captions_have_no_signs_that_the_font_lacks():
    pictures = [np.zeros((100, 400, 3), np.uint8) for _ in range(2)]
    for picture, text in zip(pictures, ("points 1–3", "points 1-3"), strict=True):
        write_caption(picture, text, LOST)
    np.testing.assert_array_equal(*pictures)


def test_the_label_of_a_scale_is_inside_the_picture():
    white = np.full((400, 900, 3), 255, np.uint8)
    bar = Bar(ends=np.array([[780.0, 390], [890, 390]]), length=110.0, length_se=0.1)
    picture = overlay_of_scale(white, bar, "3.1 µm/px")
    _, across = np.nonzero((picture < 40).all(axis=2)[:370])
    assert len(across) > 50
    assert across.max() < 895


def test_small_pictures_show_absent_landmarks_as_rings(fitted):
    image, result = fitted
    present = np.full(len(result.landmarks), 0.99)
    whole = replace(result, present=present)
    damaged = replace(result, present=np.where(np.arange(len(present)) == 3, 0.01, present))
    assert is_there(thumbnail(image, damaged, 256), ABSENT, 40) and not is_there(
        thumbnail(image, whole, 256), ABSENT, 40
    )


@pytest.mark.parametrize("status", [FitStatus.CONVERGED, FitStatus.DOUBTFUL, FitStatus.DIVERGED])
def test_small_pictures_show_the_colour_of_the_status_more_than_its_dark_edges(fitted, status):
    image, result = fitted
    contours = tuple((contour.indices, contour.closed) for contour in load_heads()[1][0].landmarks.contours)
    fit = replace(result, status=status, present=None, contours=contours)
    drawn = thumbnail(np.full_like(image, 255), fit, 256).astype(float)
    marked = 255.0 - drawn[drawn.min(axis=2) < 200]
    # Each pixel is white with shares of the colour and of the dark edge, which least squares estimate.
    paints = 255.0 - np.array([rgb(status.colour), (0, 0, 0)])
    colour, dark = np.linalg.lstsq(paints.T, marked.T, rcond=None)[0].mean(axis=1)
    assert colour > dark


def test_a_scale_has_no_marks_beyond_the_ticks_of_its_ruler():
    picture = np.full((80, 400, 3), 120, np.uint8)
    picture[20:60, 30:371] = 235  # the card, whose edges lie where further ticks would be
    ticks = range(50, 351, 10)
    for x in ticks:
        picture[25:45, x - 1 : x + 2] = 30
    assert marks_of(picture, 30.0, 370.0) == marks_of(picture, 50.0, 350.0) == list(ticks)
    picture[:] = 255 - picture  # bright ticks
    assert marks_of(picture, 30.0, 370.0) == list(ticks)
    picture[25:45, 149:152] = 255 - 235  # a worn tick among the others
    assert marks_of(picture, 30.0, 370.0) == list(ticks)


def marks_of(picture, first, last):
    """Return where along a level ruler, of which the search has counted every 10th pixel as a tick, marks are drawn."""
    n_ticks = round((last - first) / 10) + 1
    found = Ruler(period=10.0, period_se=0.01, ends=np.array([[first, 35], [last, 35]]), n_ticks=n_ticks)
    drawn = overlay_of_scale(picture, found, "")
    zoom = drawn.shape[1] / picture.shape[1]
    row = np.abs(drawn[round(29 * zoom)].astype(int) - rgb(LOST)).max(axis=1) <= 12
    (at,) = np.nonzero(row)
    return sorted({round((x + 0.5) / zoom - 0.5, -1) for x in at.tolist()})
