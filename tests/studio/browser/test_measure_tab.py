"""The Measure tab: measures by clicking, the live table and histogram, and the space of shapes."""

import csv
from pathlib import Path

import numpy as np
import pytest
from people import client, drag, opened, saved, shoot, untrained, wait_for, wait_until

from liaam.io import Landmarks, read_landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

WING = np.array(
    [[40, 120], [90, 70], [150, 60], [220, 80], [280, 110], [230, 150], [170, 170], [110, 160], [130, 110], [190, 115]],
    float,
)
NAMES = ("base", "sc", "r1", "r2", "tip", "m1", "m2", "cu", "fork", "cross")
CURVE = {"indices": [0, 1, 2, 3, 4], "closed": False}
UNUSUAL = "male_03.png"


@pytest.fixture
def wings(tmp_path) -> Path:
    """Give a folder of 24 wings of two sexes, which differ in the place of the tip; two points of one are exchanged."""
    rng = np.random.default_rng(7)
    folder = tmp_path / "wings"
    folder.mkdir()
    for i in range(24):
        sex = "female" if i % 2 else "male"
        points = WING + rng.normal(0, 1.5, WING.shape) + (0, 10)
        points[4] += (8 if sex == "male" else -8, 0)
        name = f"{sex}_{i // 2 + 1:02d}"
        if f"{name}.png" == UNUSUAL:
            points[[6, 8]] = points[[8, 6]]
        write_image(folder / f"{name}.png", rng.integers(90, 160, (240, 320, 3), dtype=np.uint8))
        write_landmarks(folder / f"{name}.ljson", Landmarks(points, (), NAMES))
    return folder


@pytest.fixture
def measuring(serve, page, wings):
    """Give the page with the Measure tab open."""
    open_measures(page, serve(wings).address)
    return page


def open_measures(page, address: str) -> None:
    """Open the page of a folder, and its Measure tab."""
    untrained(page)
    page.goto(address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source()")
    page.locator("[data-testid=tab-measure]").click()
    page.locator("[data-testid=measure-table]").wait_for()


def add(page, kind: str, *points: int) -> None:
    """Make a measure by clicking its points."""
    page.locator(f"[data-testid=measure-kind-{kind}]").click()
    for point in points:
        page.locator(f".plot-pick[data-index='{point}']").click()
    if kind in ("area", "length"):
        page.locator("[data-testid=measure-add]").click()


def column(page, measure: str) -> list:
    """What the page knows of a measure, once it has been measured."""
    find = "measure => window.liaamStudio.measure.data()?.columns.find((each) => each.measure === measure)"
    wait_for(page, find, measure)
    return page.evaluate(find, measure)["values"]


def test_measures_are_made_by_clicking_and_follow_the_points(measuring, wings, artefacts):
    page = measuring
    add(page, "distance", 0, 4)
    add(page, "angle", 0, 8, 4)
    add(page, "area", 0, 1, 2, 3)
    add(page, "length", 0, 1, 2, 3, 4)
    points = read_landmarks(wings / "female_01.ljson").points
    names = page.evaluate("() => window.liaamStudio.measure.data().pictures")
    at = names.index("female_01.png")
    lengths = np.linalg.norm(np.diff(points[:5], axis=0), axis=1)
    assert column(page, "length:1-2-3-4-5")[at] == pytest.approx(lengths.sum(), abs=1e-3)
    assert column(page, "distance:1-5")[at] == pytest.approx(np.linalg.norm(points[4] - points[0]), abs=1e-3)
    shoot(page, artefacts, "measure-1280")
    page.locator("[data-testid^=sort-distance]").click()
    wait_until(page, lambda: "base – tip" in page.locator("[aria-label=Histogram] h2").inner_text())
    assert page.locator(".plot-bar").count() >= 5
    region = page.locator("[aria-label='Table of all pictures']")
    assert region.inner_text() == region.locator("table").inner_text(), "something stands below a complete table"
    page.locator("tr[data-index]").first.locator("button").click()
    shortest = names[int(np.argmin(column(page, "distance:1-5")))]
    wait_for(page, "name => window.liaamStudio.state.current === name", shortest)
    page.locator("[data-testid=measure-open]").click()
    opened(page, shortest)
    before = column(page, "distance:1-5")[names.index(shortest)]
    x, y = client(page, 4)
    drag(page, [x, y], [x + 40, y])
    saved(page)
    shoot(page, artefacts, "measure-over-the-picture")
    page.locator("[data-testid=tab-measure]").click()
    find = "([i, before]) => window.liaamStudio.measure.data().columns[0].values[i] > before + 5"
    wait_for(page, find, [names.index(shortest), before])


def test_a_measure_is_named_where_it_is_listed(measuring, artefacts):
    page = measuring
    add(page, "distance", 0, 4)
    add(page, "angle", 0, 8, 4)
    names = page.locator("[data-testid=measure-name]")
    names.nth(0).fill("Wing length")
    names.nth(0).press("Enter")
    page.locator("[aria-label=Histogram] h2", has_text="Wing length, px").wait_for()
    names.nth(1).fill("wing length")
    names.nth(1).press("Tab")
    fault = page.locator("[data-testid=measure-name-fault]")
    fault.get_by_text("is the name of another measure (distance: base – tip): choose another name").wait_for()
    assert names.nth(1).input_value() == "wing length"
    shoot(page, artefacts, "measure-names-1280")
    names.nth(1).fill("opening")
    names.nth(1).press("Enter")
    fault.wait_for(state="hidden")
    page.locator("th", has_text="opening, °").wait_for()
    with page.expect_download() as download:
        page.locator("[data-testid=measure-save]").select_option("csv")
    head = Path(download.value.path()).read_text().splitlines()[0].split(",")
    assert {"Wing_length", "opening_deg"} <= {*head}
    page.locator(".toast.good", has_text=f"Saved {download.value.suggested_filename}").wait_for()
    names.nth(1).fill("")  # what is typed is not brought back once the focus has left the field
    page.locator("[data-testid=measure-chosen]").click()
    page.keyboard.press("Control+z")
    assert names.nth(1).input_value() == ""
    page.get_by_role("button", name="Remove distance: base – tip").click()
    page.locator(".toast", has_text="Wing length removed.").get_by_role("button", name="Undo").click()
    page.locator("th", has_text="Wing length, px").wait_for()
    page.locator("[data-testid=measure-scale]").fill("3-4=0,5 mm")
    page.locator("[data-testid=measure-scale]").press("Enter")
    page.locator("[data-testid=measure-scale-means]", has_text="r1 to r2 is 0,5 mm in every picture").wait_for()
    page.locator("[data-testid=measure-view-shapes]").click()
    told = page.locator("[data-testid=left-out-none]")
    told.filter(has_text="Shapes of all 24 pictures, without r1 and r2, the ends of the scale").wait_for()
    page.locator("[data-testid=measure-view-measures]").click()
    about = page.locator("[data-testid=measure-save]").get_attribute("title")  # what X1, Y1 and so on are of
    assert f"of the points 1 {NAMES[0]}, 2 {NAMES[1]}, " in about


def test_pictures_without_a_measure_come_last_in_either_order_and_those_without_a_shape_are_told(serve, page, wings):
    (wings / "female_03.ljson").unlink()
    incomplete = wings / "male_02.ljson"
    points = read_landmarks(incomplete).points.copy()
    points[4] = np.nan
    write_landmarks(incomplete, Landmarks(points, (), NAMES))
    open_measures(page, serve(wings).address)
    add(page, "distance", 0, 4)
    lengths = column(page, "distance:1-5")
    rising = sorted((i for i, length in enumerate(lengths) if length is not None), key=lambda i: lengths[i])
    last = [i for i, length in enumerate(lengths) if length is None]
    assert len(last) == 1
    find = "() => [...document.querySelectorAll('tr[data-index]')].map((row) => Number(row.dataset.index))"
    for order in (rising + last, rising[::-1] + last):
        page.locator("[data-testid^=sort-distance]").click()
        wait_until(page, lambda order=order: page.evaluate(find) == order)
    told = page.locator("[data-testid=left-out]")
    assert told.inner_text() == "Measures of 23 of 24 pictures. Missing: 1 picture"
    page.locator("[data-testid=measure-view-shapes]").click()
    told.get_by_text("Shapes of 22 of 24 pictures. Missing: 2 pictures").click()
    assert told.locator("li").all_inner_texts() == [
        "1 picture has no points yet – female_03.png",
        "1 picture is not finished: points are missing – male_02.png",
    ]
    told.get_by_text("male_02.png").click()
    wait_for(page, "() => window.liaamStudio.state.current === 'male_02.png'")
    page.locator("[data-testid=measure-estimate]").check()
    told.get_by_text("Shapes of 23 of 24 pictures, 1 of them with estimated points. Missing: 1 picture").wait_for()


def test_an_unusual_shape_is_one_click_away(measuring, artefacts):
    page = measuring
    page.locator("[data-testid=measure-view-shapes]").click()
    outlier = page.locator("[data-testid=shape-outlier]").first
    assert outlier.inner_text() == UNUSUAL
    outlier.click()
    wait_for(page, "name => window.liaamStudio.state.current === name", UNUSUAL)
    assert page.locator("[data-testid=shape-scatter] .plot-mark.chosen.unusual").count() == 1
    assert page.locator("[data-testid=shape-scatter] .plot-mark").count() == 24
    page.locator("[data-testid=shape-change]").select_option("selected")
    page.locator(f"[data-testid=shape-grid] svg[aria-label*='to {UNUSUAL}']").wait_for()
    shoot(page, artefacts, "shapes-1280")
    page.keyboard.press("Enter")
    opened(page, UNUSUAL)


def test_groups_have_colours_a_test_and_a_grid_between_their_means(measuring, artefacts, tmp_path):
    page = measuring
    page.locator("[data-testid=measure-by]").select_option("name")
    page.locator("[data-testid=measure-legend]", has_text="female").wait_for()
    page.locator("[data-testid=measure-view-shapes]").click()
    assert "female – male" in page.locator("[data-testid=shape-tests]").inner_text()
    page.locator("[data-testid=measure-view-measures]").click()
    fills = page.locator(".plot-bar").evaluate_all("bars => bars.map((bar) => bar.getAttribute('fill'))")
    assert {*fills} - {None} == {"#0072b2", "#d55e00"}  # those of the legend
    page.locator("[data-testid=measure-view-shapes]").click()
    page.locator("[data-testid=shape-change]").select_option("0>1")
    grid = page.locator("[data-testid=shape-grid] svg[aria-label*='from female to male']")
    grid.wait_for()
    # The longest arrow is that of the tip, which is what the sexes differ in.
    arrows = grid.locator(".plot-arrow").get_attribute("d").split("M")[1:]
    ends = [np.array([[float(v) for v in place.split()] for place in arrow.split("L")]) for arrow in arrows]
    assert np.argmax([np.linalg.norm(end[1] - end[0]) for end in ends]) == NAMES.index("tip")
    shoot(page, artefacts, "shapes-groups-1280")
    page.locator("[data-testid=measure-by]").select_option("table")
    assert "columns picture and group" in page.locator("dialog[open]").inner_text()
    with page.expect_file_chooser():
        page.locator("[data-testid=measure-table-choose]").click()
    table = tmp_path / "groups.csv"
    rows = [f"{sex}_{i:02d},{'a' if i < 6 else 'b'}" for sex in ("male", "female") for i in range(1, 13)]
    table.write_text("\n".join(["picture,group", *rows]))
    page.locator("[data-testid=measure-table-file]").set_input_files(table)
    page.locator("[data-testid=shape-tests]", has_text="a – b").wait_for()
    with page.expect_download() as download:
        page.locator("[data-testid=measure-save]").select_option("csv")
    saved_rows = list(csv.DictReader(Path(download.value.path()).read_text().splitlines()))
    assert {row["specimen"]: row["group"] for row in saved_rows}["male_03"] == "a"
    assert abs(float(saved_rows[0]["PC1"])) < 1 and float(saved_rows[0]["distance_from_mean"]) > 0
    with page.expect_download() as download:
        page.locator("[data-testid=measure-save]").select_option("svg")
    drawn = Path(download.value.path()).read_text()
    assert drawn.startswith("<svg") and "var(--" not in drawn


def test_without_landmarks_the_tab_says_what_to_do(serve, page, folder):
    page.goto(serve(folder).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source()")
    page.locator("[data-testid=tab-measure]").click()
    page.get_by_role("button", name="Place landmarks").click()
    page.locator("[data-testid=tab-annotate][aria-selected=true]").wait_for()


def test_a_server_at_another_port_has_the_same_measures_groups_and_name(serve, open_page, wings):
    server = serve(wings)
    page = open_page()
    open_measures(page, server.address)
    add(page, "distance", 0, 4)
    page.locator("[data-testid=measure-by]").select_option("name")
    page.locator("[data-testid=measure-legend]", has_text="female").wait_for()
    page.locator("[data-testid=tab-annotate]").click()
    page.get_by_title("Your name in the history").click()
    page.locator("[data-testid=who]").fill("Anna")
    page.locator("[data-testid=who-save]").click()
    wait_for(page, "() => window.liaamStudio.state.project.who === 'Anna'")
    server.kill()
    other = open_page()
    open_measures(other, serve(wings).address)
    assert len(column(other, "distance:1-5")) == 24
    other.locator("[data-testid=measure-legend]", has_text="female").wait_for()
    assert other.locator("[data-testid=measure-list] li").all_inner_texts() == ["distance: base – tip"]
    other.locator("[data-testid=tab-annotate]").click()
    assert other.get_by_title("Your name in the history").inner_text() == "Anna"
