"""The whole way through the studio, in a real browser: from a new folder to a picture without its shading."""

import numpy as np
import pytest
from people import (
    POINTS,
    annotate,
    client,
    drag,
    dragging,
    errors,
    kill,
    make_template,
    open_picture,
    opened,
    picture,
    place_all,
    points_of,
    saved,
    shoot,
    untrained,
    wait_for,
    wait_for_point,
    wait_for_state,
)

from liaam.io import read_image, read_landmarks, write_image

pytestmark = pytest.mark.slow


def test_a_new_folder_becomes_a_model_and_a_picture_without_its_shading(
    serve, page, whole_folder, portraits, lit_portrait, artefacts, tmp_path
):
    truths = {f"portrait-{i + 1:02d}.png": scene.landmarks[POINTS] for i, scene in enumerate(portraits)}
    names = list(truths)
    page.goto(serve(whole_folder).address)
    make_template(page, truths[names[0]])
    shoot(page, artefacts, "01-template")
    assert errors(page, truths[names[0]]).max() < 0.8  # a click is as good as the screen's pixels
    for name in names[1:5]:
        open_picture(page, name)
        place_all(page, truths[name])
        assert errors(page, truths[name]).max() < 1.6
        page.locator("[data-testid=accept-next]").click()  # those that were near enough are still as proposed
        saved(page)
        wait_for_state(page, name, "done")
    shoot(page, artefacts, "02-five-annotated")
    # Training begins by itself from four pictures on; with five it is asked for anew.
    wait_for(page, "() => window.liaamStudio.state.project.training.state !== 'running'")
    page.locator("[data-testid=train]").click()
    shoot(page, artefacts, "03-training")
    wait_for(
        page,
        "() => window.liaamStudio.state.project.model?.n_images === 5 && "
        "window.liaamStudio.state.project.training.state === 'done'",
    )
    wait_for(page, "() => window.liaamStudio.state.project.pictures.filter(p => p.state === 'proposed').length === 7")
    off = []
    for name in names[5:]:
        open_picture(page, name)
        assert annotate(page, "source()") == "proposal"
        off.append(errors(page, truths[name]).mean())
    assert np.median(off) < 3.0, f"pre-placed points are {np.round(off, 2)} px off"
    shoot(page, artefacts, "04-proposal")
    # Correct one, and go on to the picture that teaches most.
    ranks = {name: picture(page, name)["rank"] for name in names[5:]}
    assert sorted(ranks.values()) == list(range(1, 8))
    hardest = min(ranks, key=ranks.__getitem__)
    open_picture(page, hardest)
    place_all(page, truths[hardest])
    starred = page.locator(".strip-item:has(.strip-next)")
    after = starred.get_attribute("data-name")  # where the star is, Enter leads to
    page.locator("[data-testid=accept-next]").click()
    saved(page)
    wait_for(page, "name => window.liaamStudio.annotate.name() !== name", hardest)
    assert annotate(page, "name()") == after
    marks = read_landmarks(whole_folder / f"{hardest[:-4]}.ljson")
    assert np.linalg.norm(marks.points - truths[hardest], axis=1).max() < 1.6
    assert len(marks.contours) == 7
    # A picture under another light, dropped in.
    lit = tmp_path / "lit.png"
    write_image(lit, lit_portrait.image)
    page.locator("[data-testid=tab-fit]").click()
    page.locator("[data-testid=fit-file]").set_input_files(lit)
    wait_for(page, "() => window.liaamStudio.fit.fit?.width === 640")
    found = page.evaluate("() => window.liaamStudio.fit.fit")
    assert found["ok"], found["message"]
    assert np.linalg.norm(np.array(found["shape"]) - lit_portrait.landmarks[POINTS], axis=1).mean() < 5.0
    shoot(page, artefacts, "05-fit")
    page.locator("[data-testid=layer-flat]").click()
    wait_for(page, "() => window.liaamStudio.fit.view === 'flat' && window.liaamStudio.fit.hasLayer")
    shoot(page, artefacts, "06-flat")
    page.locator("[data-testid=export-menu]").click()
    with page.expect_download() as download:
        page.locator("[data-testid=export-flat]").click()
    download.value.save_as(tmp_path / "flat.png")
    flat = read_image(tmp_path / "flat.png")
    assert flat.shape == (480, 640, 3)
    # The lamp stood at the left; without its shading the two halves of the face are nearer to one another.
    assert imbalance(flat, lit_portrait) < 0.5 * imbalance(lit_portrait.image, lit_portrait)
    # Nothing but landmarks, and what the studio keeps for itself, came into the whole_folder.
    kinds = {path.suffix for path in whole_folder.iterdir() if path.name != ".liaam-studio"}
    assert kinds == {".png", ".ljson"}


def imbalance(image: np.ndarray, scene) -> float:
    """How much brighter one cheek is than the other, as a logarithm."""
    left, right = scene.landmarks[[2, 3, 4]].mean(axis=0), scene.landmarks[[8, 9, 10]].mean(axis=0)
    nose = scene.landmarks[[45, 49]].mean(axis=0)
    places = [np.rint(0.5 * (side + nose)).astype(int) for side in (left, right)]
    values = [image[y - 8 : y + 9, x - 8 : x + 9].astype(float).mean() for x, y in places]
    return abs(float(np.log(values[0] / values[1])))


@pytest.fixture
def annotated(page, whole_folder, portraits):
    """Give a folder with pictures annotated as the studio would have, and let the page not train on them."""
    from liaam.io import Contour, Landmarks, write_landmarks

    untrained(page)
    contours, first = [], 0
    from people import PATHS

    for count, closed in PATHS:
        contours.append(Contour(tuple(range(first, first + count)), closed))
        first += count
    for i, scene in enumerate(portraits[:5]):
        path = whole_folder / f"portrait-{i + 1:02d}.ljson"
        write_landmarks(path, Landmarks(scene.landmarks[POINTS], tuple(contours)))
    return whole_folder


def test_a_reload_keeps_what_was_done(serve, page, annotated):
    page.goto(serve(annotated).address)
    open_picture(page, "portrait-02.png")
    drag(page, client(page, 3), [v + 30 for v in client(page, 3)])
    moved = points_of(page)
    page.reload()  # at once, while it may not have been saved yet
    opened(page, "portrait-02.png")
    assert np.abs(points_of(page) - moved).max() < 0.02
    saved(page)
    stored = read_landmarks(annotated / "portrait-02.ljson").points
    assert np.abs(stored - moved).max() < 0.02


def test_a_killed_server_loses_nothing(serve, page, annotated):
    first = serve(annotated, "--port", "0")
    page.goto(first.address)
    open_picture(page, "portrait-03.png")
    drag(page, client(page, 5), [v + 20 for v in client(page, 5)])
    saved(page)
    kept = points_of(page)
    port = first.address.split(":")[2].split("/")[0]
    kill(first, page)
    assert np.abs(read_landmarks(annotated / "portrait-03.ljson").points - kept).max() < 0.02
    drag(page, client(page, 6), [v + 20 for v in client(page, 6)])  # nobody listens now
    page.wait_for_selector("[data-testid=save-status]:not([data-state=saved])")
    late = points_of(page)
    second = serve(annotated, "--port", port)
    page.goto(second.address)  # as a person does: the new server has a new token
    open_picture(page, "portrait-03.png")
    assert np.abs(points_of(page) - late).max() < 0.02
    saved(page)
    assert np.abs(read_landmarks(annotated / "portrait-03.ljson").points - late).max() < 0.02


def test_two_tabs_do_not_overwrite_one_another(serve, page, annotated):
    address = serve(annotated).address
    page.goto(address)
    open_picture(page, "portrait-04.png")
    other = page.context.new_page()
    other.goto(address)
    open_picture(other, "portrait-04.png")
    drag(page, client(page, 2), [v + 25 for v in client(page, 2)])
    saved(page)
    mine = points_of(page)
    # The other tab follows, as it has nothing unsaved.
    wait_for_point(other, 2, mine[2].tolist())
    other.close()


def test_a_tab_that_has_missed_a_change_is_asked(serve, page, annotated):
    page.goto(serve(annotated).address)
    open_picture(page, "portrait-04.png")
    from liaam.io import Landmarks, write_landmarks

    stored = read_landmarks(annotated / "portrait-04.ljson")
    start = client(page, 1)
    with dragging(page, start, [v + 25 for v in start]):  # otherwise the page may find the change first, and follows
        write_landmarks(annotated / "portrait-04.ljson", Landmarks(stored.points + 2.0, stored.contours))
    page.locator("[data-testid=conflict-theirs]").click()
    wait_for_point(page, 1, (stored.points[1] + 2.0).tolist())
    saved(page)
    assert np.abs(points_of(page) - stored.points - 2.0).max() < 0.02
    assert np.abs(read_landmarks(annotated / "portrait-04.ljson").points - stored.points - 2.0).max() < 0.02


def test_a_corrupt_picture_holds_nothing_up(serve, page, annotated, artefacts):
    (annotated / "broken.png").write_bytes((annotated / "portrait-01.png").read_bytes()[:500])
    (annotated / "text.jpg").write_text("no picture")
    page.goto(serve(annotated).address)
    page.wait_for_selector("[data-testid=strip] [data-name='text.jpg'][data-state=broken]")
    page.locator("[data-testid=strip] [data-name='text.jpg']").click()
    shoot(page, artefacts, "07-broken-picture")
    open_picture(page, "portrait-01.png")
    drag(page, client(page, 1), [v + 15 for v in client(page, 1)])
    saved(page)
    wait_for_state(page, "portrait-01.png", "done")


def test_a_picture_of_24_megapixels_is_annotated_to_the_pixel(serve, page, annotated, portraits, artefacts):
    import cv2

    large = cv2.resize(portraits[6].image, (4000, 6000), interpolation=cv2.INTER_CUBIC)
    write_image(annotated / "large.jpg", large)
    page.goto(serve(annotated).address)
    open_picture(page, "large.jpg")
    wait_for(page, "() => window.liaamStudio.state.picture('large.jpg').width === 4000")
    target = (portraits[6].landmarks[POINTS[:3]] + 0.5) * (4000 / 240) - 0.5
    scale = page.evaluate("() => window.liaamStudio.annotate.viewer.scale")
    place_all(page, target, near=1.5 / scale)
    saved(page)
    shoot(page, artefacts, "08-24-megapixels")
    assert np.abs(read_landmarks(annotated / "large.ljson").points[:3] - target).max() < 1.5 / scale


def test_fifty_steps_are_undone_and_done_again(serve, page, annotated):
    page.goto(serve(annotated).address)
    open_picture(page, "portrait-05.png")
    start = points_of(page)
    for step in range(50):
        i = step % len(start)
        x, y = client(page, i)
        drag(page, [x, y], [x + 8 * (-1) ** step, y + 6], steps=1)
    end = points_of(page)
    assert annotate(page, "undoSteps()") == 50
    assert np.abs(end - start).max() > 1
    for _ in range(50):
        page.keyboard.press("Control+z")
    assert np.abs(points_of(page) - start).max() < 1e-9
    saved(page)
    assert np.abs(read_landmarks(annotated / "portrait-05.ljson").points - start).max() < 0.02
    for _ in range(50):
        page.keyboard.press("Control+y")
    assert np.abs(points_of(page) - end).max() < 1e-9
    saved(page)
    assert np.abs(read_landmarks(annotated / "portrait-05.ljson").points - end).max() < 0.02
