"""From landmark files to a fitted picture on real faces, in three formats."""

import numpy as np
import pytest

import liaam
from liaam.fitting import Finder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "training", "test", "limit"),
    [
        ("imm", "07-[12346]*", "07-5m", 0.025),  # .pts; the test picture is spot-lit
        ("imm-frontal", "0[1-3]_*", "02_07", 0.012),  # .asf
        ("london", "0[0-3]*", "020_03", 0.02),  # .tem
    ],
)
def test_a_box_leads_to_the_landmarks(shared_data, folder, training, test, limit):
    data = liaam.load_folder(shared_data / folder)
    held_out = next(sample for sample in data if sample.name == test)
    model = liaam.train(data.select(training).select(lambda sample: sample.name != test))
    truth = held_out.landmarks.points
    size = np.hypot(*np.ptp(truth, axis=0))
    box = (*(truth.min(axis=0) - 0.02 * size), *(truth.max(axis=0) + 0.03 * size))
    result = liaam.fit(model, held_out.read_image(), box)
    assert result.status.ok
    errors = [np.linalg.norm(shape - truth, axis=1).mean() / size for shape in (result.start, result.landmarks)]
    assert errors[1] < min(limit, 0.8 * errors[0])


@pytest.mark.parametrize(
    ("folder", "training", "tests"),
    [
        ("imm", ["0[1568]-[12346]*", "1[0-5]-[12346]*"], ["16-1m", "17-5m", "18-3m", "20-4m", "22-2f", "24-6m"]),
        pytest.param("imm-frontal", ["0[1-3]_*"], ["04_01", "05_05", "06_09"], marks=pytest.mark.slow),
        pytest.param("london", ["0[0-3]*"], ["042_03", "066_03", "091_03"], marks=pytest.mark.slow),
    ],
)
def test_faces_of_others_are_found(shared_data, folder, training, tests):
    data = liaam.load_folder(shared_data / folder)
    # Without lamps, which take longer: models of real faces with them are those of the test above.
    finder = Finder(liaam.train(data.select(training), leave_out=False, lamps=None))
    for sample in data.select(tests):
        (found,) = finder.find(sample.read_image())
        truth = sample.landmarks.points
        # About a quarter of the distance between the eyes.
        assert np.linalg.norm(found.landmarks - truth, axis=1).mean() < 0.08 * np.hypot(*np.ptp(truth, axis=0)), (
            sample.name
        )
        assert not found.doubtful
