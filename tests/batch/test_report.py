"""The report: one page of fits, the worst first, which escapes what it shows and holds a table that can be measured."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from liaam.batch import write_report
from liaam.batch.report import entry_of_fit, write_entries
from liaam.errors import ImageError, LiaamError
from liaam.fitting import FitResult, FitStatus, fit_many
from liaam.io import write_image
from liaam.morphometry import read_specimens

NAME = "<b>&amp;\"'.png"


@pytest.fixture(scope="module")
def images(moving, tmp_path_factory) -> list[Path]:
    """Give four image files, one of them with a name that is markup."""
    folder = tmp_path_factory.mktemp("report")
    paths = [folder / name for name in ("frame 1.png", "frame2.png", "frame10.png", NAME)]
    for path, scene in zip(paths, moving, strict=False):
        write_image(path, scene.image)
    return paths


@pytest.fixture(scope="module")
def fits(head_model, moving, images) -> list[FitResult]:
    """Give their fits, with qualities and statuses of all grades."""
    found = fit_many(head_model, images, [scene.landmarks for scene in moving[: len(images)]])
    return [
        replace(found[0], quality=0.9, status=FitStatus.CONVERGED),
        replace(found[1], quality=0.8, status=FitStatus.CONVERGED),
        replace(found[2], quality=0.1, status=FitStatus.DOUBTFUL),
        replace(found[3], quality=0.0, status=FitStatus.DIVERGED, landmarks=np.full((58, 2), np.nan)),
    ]


def names_on(page: Path) -> list[str]:
    """Names of the cards of a page, in order, as they are in its source."""
    return re.findall(r"<h3>(?:<a [^>]*>)?(.*?)(?:</a>)?</h3>", page.read_text("utf-8"))


def table_on(page: Path, to: Path) -> Path:
    """Save the table of a page, as its button does."""
    (text,) = re.findall(r'id="csv">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)
    to.write_text(json.loads(text), "utf-8")
    return to


def test_the_worst_come_first_and_names_are_escaped(fits, images, tmp_path):
    page = tmp_path / "report.html"
    error = ImageError("b.png is damaged <script>alert(1)</script>: copy it again")
    write_report(page, [*fits, error], [*images, "b.png"])
    escaped = "&lt;b&gt;&amp;amp;&quot;&#x27;.png"
    assert names_on(page) == ["b.png", escaped, "frame10.png", "frame2.png", "frame 1.png"]
    text = page.read_text("utf-8")
    assert "<script>alert" not in text
    assert NAME not in text
    assert not re.findall(r"(?:src|href)=\"(?:https?:)?//", text)  # nothing is loaded
    assert text.count("<img ") == 4
    assert 'href="../' in text and "frame%201.png" in text
    assert all(f'value="{status}" checked' in text for status in ("error", "diverged", "doubtful", "converged"))
    assert not re.findall("<!--.*?-->", text)  # all parts are filled in


def test_the_table_of_the_page_can_be_measured(fits, images, tmp_path):
    write_report(tmp_path / "report.html", fits, images, title="wings")
    assert "<title>wings</title>" in (tmp_path / "report.html").read_text("utf-8")
    specimens = read_specimens(table_on(tmp_path / "report.html", tmp_path / "fits.csv"))
    assert {specimen.name for specimen in specimens} >= {"frame 1", "frame2", "frame10"}
    first = next(specimen for specimen in specimens if specimen.name == "frame 1")
    np.testing.assert_allclose(first.points, fits[0].landmarks, rtol=1e-6)
    assert first.status == "converged"


@pytest.fixture
def damaged(fits) -> FitResult:
    """Give a fit whose second landmark is absent."""
    present = np.full(len(fits[0].landmarks), 0.99)
    present[1] = 0.01
    return replace(fits[0], present=present)


def test_absent_landmarks_are_empty_in_the_table_unless_asked_for(damaged, images, tmp_path):
    page = tmp_path / "report.html"
    for absent in ("empty", "estimate"):
        write_report(page, [damaged], images[:1], absent=absent)
        (specimen,) = read_specimens(table_on(page, tmp_path / "fits.csv"))
        assert np.isnan(specimen.points[1]).all() == (absent == "empty")
        assert np.isfinite(specimen.points[2]).all()
    with pytest.raises(LiaamError, match="absent 'none' is unknown"):
        write_report(page, [damaged], images[:1], absent="none")


def test_the_legend_is_about_the_status_and_not_about_a_fit(damaged, images, tmp_path):
    page = tmp_path / "report.html"
    write_report(page, [damaged], images[:1])
    (meaning,) = re.findall("<dd>(.*?)</dd>", page.read_text("utf-8"))
    assert meaning == FitStatus.CONVERGED.message


def test_what_cannot_be_reported_is_refused_by_name(fits, images, tmp_path):
    with pytest.raises(LiaamError, match=r"report\.pdf: a report is a web page; give a name that ends in \.html"):
        write_report(tmp_path / "report.pdf", fits, images)
    (tmp_path / "mine.html").write_text("<html>my own page</html>")
    with pytest.raises(
        LiaamError, match=r"mine\.html exists and is not a report of liaam; give another name to keep it"
    ):
        write_report(tmp_path / "mine.html", fits, images)
    with pytest.raises(LiaamError, match="4 results and 1 images: give the image of each result"):
        write_report(tmp_path / "report.html", fits, images[:1])
    bare = replace(fits[0], image=None)
    with pytest.raises(LiaamError, match=r"images\[0\]: the result does not name its image; give images="):
        write_report(tmp_path / "report.html", [bare])
    entry = entry_of_fit(fits[0], np.zeros((160, 120, 3), np.uint8), "a.png", "a.png")
    with pytest.raises(LiaamError, match=r"a\.png has 58 landmarks, not 5; report one model's fits"):
        write_entries(tmp_path / "report.html", [entry], 5, ())
    assert not (tmp_path / "report.html").exists()


def test_a_page_of_nothing_and_of_arrays(fits, tmp_path, moving):
    for _ in range(2):  # a report may be replaced
        write_report(tmp_path / "none.html", [])
    assert "<title>0 fits</title>" in (tmp_path / "none.html").read_text("utf-8")
    write_report(tmp_path / "arrays.html", [replace(fit, image=None) for fit in fits], [s.image for s in moving[:4]])
    assert names_on(tmp_path / "arrays.html") == ["images[3]", "images[2]", "images[1]", "images[0]"]
