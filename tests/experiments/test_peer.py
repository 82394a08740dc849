"""The peer's protocol, on generated persons and on three real ones."""

import numpy as np
import pytest

from experiments import peer
from experiments.runner import run_experiment
from liaam.errors import LiaamError
from liaam.model.shape import align, diagonal_of
from setups import copy_files

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("unseen", [False, True])
def test_the_peers_folds(small, unseen):
    folds, _ = peer.get_folds(small, unseen)
    assert len(folds) == (2 if unseen else 1)
    for fold in folds:
        parts = [{sample.name for sample in samples} for samples in (fold.training, fold.tested)]
        assert not parts[0] & parts[1]
        persons = [{name[:2] for name in part} for part in parts]
        assert not persons[0] & persons[1] if unseen else persons[0] == persons[1]
    tested = [sample.name for fold in folds for sample in fold.tested]
    assert len(tested) == len(set(tested)) == (12 if unseen else 6)


def test_the_peers_figures_are_told_beside_ours(done, small, tmp_path):
    _, rows, out = done("peer")
    assert "| smooth | menpofit, orientations | 1.60 | – | 18 |" in (out / "report.md").read_text()
    starts = {(r["method"], r["picture"]): set() for r in rows}
    for row in rows:
        starts[row["method"], row["picture"]].add(row["light"])
    assert all(lights == set(peer.SHOWN) for lights in starts.values())
    summary = run_experiment(peer.peer_experiment(small, ["rgb"], unseen=True), tmp_path)
    assert summary["settings"]["persons"] == "unseen"
    assert "| shadow | menpofit, orientations | 4.10 | – | – |" in (tmp_path / "report.md").read_text()


def test_two_persons_are_too_few_to_leave_two_out(folder, tmp_path):
    copy_files(folder, tmp_path, "03-[12]*", "04-[12]*")
    assert peer.get_folds(tmp_path, False)
    with pytest.raises(LiaamError, match=r"2 persons.*without --unseen"):
        peer.get_folds(tmp_path, True)


def test_a_start_in_the_box_is_disturbed_within_its_limits(rng):
    mean = rng.normal(0, 20, (30, 2))
    truth = 3 * mean + 200
    for _ in range(50):
        found = align(truth, peer.box_start(mean, truth, rng))
        assert abs(found.scale - 1) <= peer.SCALE + 1e-9
        assert abs(np.arctan2(found.matrix[1, 0], found.matrix[0, 0])) <= peer.TURN + 1e-9
        moved = found(0.5 * (truth.min(axis=0) + truth.max(axis=0))) - 0.5 * (truth.min(axis=0) + truth.max(axis=0))
        assert np.abs(moved).max() <= peer.SHIFT * diagonal_of(truth) + 1e-9


def test_orientations_stand_all_lights_on_real_faces(three_persons, tmp_path):
    summary = run_experiment(peer.peer_experiment(three_persons, ["igo"]), tmp_path)
    for light in peer.SHOWN:
        assert summary["methods"]["igo"][light]["beyond"] == 0
        assert summary["methods"]["igo"][light]["nme_median"] < 0.02
