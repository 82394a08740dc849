"""Results of fits as files."""

import json

import numpy as np

from liaam.io import Landmarks, fit_text, read_landmarks, write_fit

POINTS = np.array([[1.5, 2.0], [3.25, -4.0]])


def test_a_fit_is_written_four_times(tmp_path):
    landmarks = Landmarks(POINTS, image_name="anna.1.png", scale=0.25)
    paths = write_fit(tmp_path, "anna.1", landmarks, {"status": "converged", "cost": 0.5}, (40, 30))
    assert [path.name for path in paths] == ["anna.1.pts", "anna.1.csv", "anna.1.tps", "anna.1.json"]
    for path in paths[:3]:
        assert np.array_equal(read_landmarks(path, (40, 30)).points, POINTS)
    assert paths[2].read_text() == "LM=2\n1.5 27.0\n3.25 33.0\nIMAGE=anna.1.png\nID=anna.1\nSCALE=0.25\n"
    content = json.loads(paths[3].read_text())
    assert content == {"status": "converged", "cost": 0.5, "image_size": [40, 30], "landmarks": POINTS.tolist()}
    assert paths[3].read_text().startswith('{\n "status": "converged",\n "cost": 0.5,\n "image_size": [\n  40,')
    assert paths[3].read_text().endswith("}\n")


def test_facts_of_every_kind_become_json():
    facts = {
        "nan": float("nan"),
        "infinite": np.float32(np.inf),
        "single": np.float32(0.5),
        "count": np.int64(3),
        "flag": np.bool_(True),
        "array": np.array([[1.0, np.nan]]),
        "tuple": (1, None, "text"),
        "nested": {2: {"a": np.array([1, 2])}},
    }
    content = json.loads(fit_text(Landmarks(POINTS), facts))
    assert content == {
        "nan": None,
        "infinite": None,
        "single": 0.5,
        "count": 3,
        "flag": True,
        "array": [[1.0, None]],
        "tuple": [1, None, "text"],
        "nested": {"2": {"a": [1, 2]}},
        "landmarks": POINTS.tolist(),
    }
