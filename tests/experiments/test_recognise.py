"""Recognition across light: its rates, and a small run."""

import numpy as np
import pytest

from experiments.generic import request_of_folders
from experiments.recognise import (
    DIRECTIONS,
    METHODS,
    UnderLight,
    recognise,
    recognise_experiment,
    shape_coordinates,
    summarise,
    table,
    wilson,
)
from liaam.errors import LiaamError
from liaam.model.shape import rotation


def row(name, light, rank, method="input", start="none", direction=DIRECTIONS[0]):
    labels = {"method": method, "direction": direction, "start": start, "light": light, "object": name}
    return {**labels, "rank": rank, "of": 3, "status": "converged"}


def test_wilsons_interval():
    assert wilson(0.5, 10) == pytest.approx([0.2366, 0.7634], abs=1e-4)
    assert wilson(1.0, 30) == pytest.approx([0.8865, 1.0], abs=1e-4)


def test_rates_are_those_of_rank_1_by_group():
    ranks = {"input": {"far": (3, 1, 2), "near": (1, 1, 2), "day": (1, 1, 1)}}
    ranks |= {method: {"far": (1, 1, 3), "near": (1, 1, 1), "day": (1, 1, 1)} for method in METHODS[1:]}
    rows = [
        row(str(name), light, rank, method, direction=direction)
        for direction in DIRECTIONS
        for method, lights in ranks.items()
        for light, each in lights.items()
        for name, rank in enumerate(each)
    ]
    summary = summarise("day", ("far",), rows)
    cells = summary["starts"]["none"][DIRECTIONS[0]]
    assert list(cells) == ["day", "far", "near", "other"]
    assert cells["far"]["input"]["rank_1"] == pytest.approx(1 / 3)
    assert cells["far"]["liaam"]["times_input"] == pytest.approx(2.0)
    assert cells["other"]["input"]["rank_1"] == cells["near"]["input"]["rank_1"] == pytest.approx(2 / 3)
    low, high = cells["far"]["liaam"]["times_interval"]
    assert low < 2.0 <= high
    header, body = table(summary)
    assert {len(line) for line in body} == {len(header)}
    assert len(body) == 2 * len(METHODS)


@pytest.mark.slow
def test_a_small_run(lit):
    request, _, _ = request_of_folders(lit / "data", lit / "test", None, "1m", 60.0, starts=("box",))
    rows = recognise(request, UnderLight("box", "1m"))
    assert {each["method"] for each in rows} == set(METHODS)
    assert all(each["rank"] == 1 for each in rows)  # of images with themselves
    rows = recognise(request, UnderLight("box", "5m"))
    assert len(rows) == 2 * 3 * len(METHODS)
    ranks = {method: [each["rank"] for each in rows if each["method"] == method] for method in ("liaam", "input")}
    assert sum(ranks["liaam"]) < sum(ranks["input"])
    assert ranks["liaam"].count(1) >= 5


def test_the_pose_does_not_count_as_shape(lit):
    from experiments.generic import get_trained

    request, _, _ = request_of_folders(lit / "data", lit / "test", None, "1m", 60.0, starts=("box",))
    model = get_trained(request, 0).model
    shape = model.shape_model.shape(np.append(np.sqrt(model.shape_model.eigenvalues), np.zeros(4)))
    moved = 1.3 * shape @ rotation(0.2).T + [5.0, -3.0]
    assert shape_coordinates(model, shape) == pytest.approx(1.0, abs=0.05)
    assert shape_coordinates(model, moved) == pytest.approx(shape_coordinates(model, shape), abs=1e-9)


def test_a_light_that_no_image_has_is_an_error(lit):
    with pytest.raises(LiaamError, match=r"no image under the light dusk; choose from 1m, 5m"):
        recognise_experiment(lit / "data", lit / "test", "1m", None, 60.0, far=("dusk",))
