"""Fixtures that the protocols on folders of persons share: folders, and one finished run of each experiment."""

import csv
import json
from functools import partial

import pytest

from experiments import basin, generic, occlusion, peer, solvers, unchanged
from experiments.runner import run_experiment
from setups import copy_files, one_at_a_time, write_person

METHODS = ("rgb", "li")

MAKERS = {
    "generic": generic.generic_experiment,
    "peer": peer.peer_experiment,
    "basin": basin.basin_experiment,
    "occlusion": occlusion.occlusion_experiment,
    "unchanged": unchanged.unchanged_experiment,
}


@pytest.fixture(autouse=True, scope="session")
def without_regressors():
    """Try no regressors: of generated persons, no model would keep one, and the trial takes most of the training."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solvers, "train", partial(solvers.train, regressor=False))
        yield


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Write generated pictures of three persons, named as the spot protocol has them."""
    folder = tmp_path_factory.mktemp("persons")
    for person in (3, 4, 5):
        write_person(folder, person)
    return folder


@pytest.fixture(scope="session")
def small(folder, tmp_path_factory):
    """Give four pictures of each person."""
    return copy_files(folder, tmp_path_factory.mktemp("small"), "*-[1-4]*")


@pytest.fixture(scope="session")
def lit(folder, tmp_path_factory):
    """Give a folder with ``data``, four pictures of each person, and ``test``, the others under ``1m`` and ``5m``."""
    root = tmp_path_factory.mktemp("lit")
    copy_files(folder, root / "data", "*-[2346]m*")
    copy_files(folder, root / "test", "*-[15]m*")
    return root


@pytest.fixture(scope="session")
def make(folder, small):
    """Give an experiment by its name, with options of its own or tiny ones."""

    def call(name, **options):
        data = small if name == "peer" else folder
        return MAKERS[name](**{"data": data, "methods": METHODS, "trials": 1, "seed": 5, **options})

    return call


@pytest.fixture(scope="session")
def done(make, shared_folder):
    """Run an experiment once for all workers, when it is first asked for; gives its summary, rows and folder."""

    def get(name):
        out = shared_folder / f"experiment-{name}"
        finished = out.with_suffix(".finished")
        with one_at_a_time(out):
            if not finished.exists():
                run_experiment(make(name), out)
                finished.touch()
        return json.loads((out / "summary.json").read_text()), rows_in(out), out

    return get


@pytest.fixture(scope="session")
def read_rows():
    """Give the function that reads a finished run."""
    return rows_in


def rows_in(out):
    """Rows of a finished run, without the one column that no two runs agree on."""
    rows = list(csv.DictReader((out / "results.csv").read_text().splitlines()))
    return [{key: value for key, value in row.items() if key != "seconds"} for row in rows]


@pytest.fixture(scope="session")
def three_persons(shared_data, tmp_path_factory):
    """Copy three persons of IMM frontal, six pictures each."""
    return copy_files(shared_data / "imm-frontal", tmp_path_factory.mktemp("frontal"), "0[123]_0[1-6].*")
