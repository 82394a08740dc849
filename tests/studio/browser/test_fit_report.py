"""The report of fits in a real browser: filters, the table, no request, nothing cut off, and accessible."""

import numpy as np
import pytest
from people import violations

from liaam.batch import write_report
from liaam.errors import LiaamError
from liaam.fitting import fit_many
from liaam.model import load_model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report(portrait_model, portraits, tmp_path_factory):
    """Give a page of four fits and an error."""
    page = tmp_path_factory.mktemp("report") / "report.html"
    images = [*(scene.image for scene in portraits[8:11]), np.full((240, 320, 3), 128, np.uint8)]
    fits = fit_many(load_model(portrait_model), images)
    write_report(page, [*fits, LiaamError("cut.png is cut short: copy it again")], [*images, "cut.png"])
    return page


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_the_page_needs_no_server_fits_the_screen_and_is_accessible(open_page, report, width, scheme):
    page = open_page(width, 800, color_scheme=scheme)
    requests = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(report.as_uri())
    page.locator("summary").click()
    assert page.locator("#shown").inner_text() == "5 of 5 shown"
    assert page.locator(".cards h3").first.inner_text() == "cut.png"
    assert page.locator(".cards img").first.evaluate("image => image.decode().then(() => image.naturalWidth)") > 100
    assert not violations(page)
    page.get_by_role("checkbox", name="converged").uncheck()
    assert page.locator(".cards li:visible").count() < 5
    page.get_by_role("button", name="Table").click()
    assert page.locator(".cards").is_hidden()
    assert not violations(page)
    page.get_by_role("checkbox", name="converged").check()
    page.get_by_role("button", name="quality").click()
    page.get_by_role("button", name="quality").click()
    qualities = [text for text in page.locator("tbody tr td:nth-child(3)").all_inner_texts() if text]
    assert qualities == sorted(qualities, reverse=True)
    page.get_by_role("searchbox").fill("CUT")
    assert page.locator("#shown").inner_text() == "1 of 5 shown"
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    assert download.value.suggested_filename == "fits.csv"
    assert {url.partition(":")[0] for url in requests} <= {"file", "data", "blob"}
