"""Agreement of shapes for statistics: between observers, and of the model with a person."""

import numpy as np
import pytest
from small_projects import by_name, put, refused

from liaam.evaluation import compare_shapes
from liaam.io import write_image
from liaam.studio.agreement import model_agreement
from liaam.studio.origins import saved_proposals
from liaam.studio.project import Project
from liaam.studio.sets import agreement, make_set
from liaam.studio.shapes import GROUPS
from liaam.studio.training import HELD_OUT

BASE = np.array([[20.0, 30], [360, 40], [340, 260], [50, 250], [200, 150]])
TEMPLATE = {"names": ["a", "b", "c", "d", "e"], "contours": [], "mirror": None}


def placed_by(rng: np.random.Generator, truth: dict[str, np.ndarray], sd: float) -> dict[str, np.ndarray]:
    return {name: (points + rng.normal(0, sd, points.shape)).round(2) for name, points in truth.items()}


@pytest.fixture
def two(tmp_path, rng):
    """Give ten pictures that two observers have placed, and their points."""
    root = tmp_path / "wings"
    root.mkdir()
    for i in range(10):
        write_image(root / f"{'ab'[i % 2]}{i}.png", np.full((300, 400, 3), 90, np.uint8))
    first = Project(root)
    first.save_template(TEMPLATE)
    truth = {name: BASE + rng.normal(0, 8, BASE.shape) for name in by_name(first)}
    second = first.of_set(make_set(first, {"name": "anna", "same": True})["name"])
    points = [placed_by(rng, truth, 1.0), placed_by(rng, truth, 1.0)]
    for project, own in zip((first, second), points, strict=True):
        for name, shape in own.items():
            put(project, name, shape.tolist())
    return first, *points


def test_observers_have_the_slope_and_the_correlation_of_liaam_evaluate(two):
    first, ours, other = two
    (found,) = agreement(first)["shapes"]
    names = sorted(ours)
    known = compare_shapes(np.array([other[name] for name in names]), np.array([ours[name] for name in names]))
    assert found["names"] == ["anna", ""] and found["pictures"] == 10
    assert found["slope"] == pytest.approx(known.slope) and found["repeatability"] == pytest.approx(known.repeatability)
    assert found["attenuation"] is None and found["methods"] == known.methods()
    first.store.put(GROUPS, {"": {name: name[0] for name in ours}})
    (grouped,) = agreement(first)["shapes"]
    assert grouped["attenuation"] is not None and grouped["slope"] == found["slope"]


def test_the_model_is_compared_with_a_person_in_pictures_that_were_held_out(two, rng):
    first, ours, _ = two
    assert "no model was measured yet" in str(refused(model_agreement, first))
    mean = np.mean(list(ours.values()), axis=0)
    fits = {name: (mean + 0.6 * (points - mean)).round(3).tolist() for name, points in ours.items()}
    order = first.templates.order
    first.store.put(HELD_OUT, {"": {"order": order, "fits": fits}})
    found = model_agreement(first)
    assert found["slope"] == pytest.approx(0.6, abs=0.05)
    assert found["variance_ratio"] == pytest.approx(0.36, abs=0.05)
    first.store.put(HELD_OUT, {"": {"order": order, "fits": dict(list(fits.items())[:4])}})
    assert "4 held-out pictures" in str(refused(model_agreement, first))
    first.store.put(HELD_OUT, {"": {"order": "another", "fits": fits}})
    assert "no model was measured yet" in str(refused(model_agreement, first))


def test_the_command_leaves_out_labels_that_were_only_accepted(two, tmp_path, run):
    first, _, other = two
    name = sorted(other)[0]
    anna = first.of_set("anna")
    marks = anna.marks(name)
    accepted = [[x + 1, y] for x, y in marks["points"]]
    wanted = {"points": accepted, "invisible": [], "revision": marks["revision"], "origins": ["accepted"] * 5}
    anna.save_marks(name, wanted)
    assert list(saved_proposals(first.root / "anna")) == [name] and not saved_proposals(first.root)
    first.store.close()
    anna.store.close()
    code, out, err = run("measure", first.root, "-o", tmp_path / "t.csv", "--compare", first.root / "anna")
    assert code == 0, err
    assert "1 specimen of" in err and "accepted as the studio proposed them" in err
    assert "shapes of 9 specimens" in out
