"""From the .tps file of real specimens, as it is, to a table of measurements."""

import numpy as np
import pytest
from ktch.io import read_tps

import liaam
from liaam.io import write_collection

MEASURES = ("distance:1-5", "distance:2-6", "angle:1-2-3", "area:1-2-3-4-5-6")


@pytest.mark.slow
def test_wings(shared_data, tmp_path):
    data = liaam.load_folder(shared_data / "wings")
    tests = data.samples[::5]
    held_out = {sample.name for sample in tests}
    training = data.select(lambda sample: sample.name not in held_out)
    results = liaam.fit_many(liaam.train(training), [sample.image for sample in tests])
    assert all(result.status.ok for result in results)
    truth = np.array([sample.landmarks.points for sample in tests])
    diagonals = np.hypot(*np.ptp(truth, axis=1).T)
    errors = np.linalg.norm([result.landmarks for result in results] - truth, axis=2).mean(axis=1) / diagonals
    assert np.median(errors) <= 0.004

    # The fits are where a second reader finds them, beside the file of the people who digitised the wings.
    fits = {f"{sample.name}.jpg": liaam.Landmarks(fit.landmarks) for sample, fit in zip(tests, results, strict=True)}
    write_collection(tmp_path / "fits.tps", fits, dict.fromkeys(fits, (632, 480)))
    digitised = {own.image_path: own.landmarks for own in read_tps(shared_data / "wings" / "tps-example.tps")}
    theirs = {own.image_path: own.landmarks for own in read_tps(tmp_path / "fits.tps")}
    assert theirs.keys() == fits.keys()
    for name, points in theirs.items():
        assert np.linalg.norm(points - digitised[name], axis=1).mean() < 0.01 * diagonals.min()

    measured = liaam.measure(
        [liaam.Specimen(str(i), fit.landmarks, fit.landmark_covariances) for i, fit in enumerate(results)], MEASURES
    )
    by_hand = liaam.measure([liaam.Specimen(sample.name, sample.landmarks.points) for sample in tests], MEASURES)
    names = [
        name.removesuffix("_se") for name in measured if name.startswith(("dist", "angle", "area")) and "se" in name
    ]
    scores = [np.subtract(measured[name], by_hand[name]) / measured[f"{name}_se"] for name in names]
    assert len(scores) == len(MEASURES)
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.2
