"""All experiments behind one call: one page, resumed where it stopped."""

import json
import re

import pytest

from experiments import reconstruct, reproduce as module
from experiments.claims import CLAIMS
from experiments.reproduce import VARIANTS, Size, plan, reproduce
from liaam.errors import LiaamError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tiny():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(module.SIZES, "tiny", Size(1, 1, 1, 1, (0.0, 4.0), (0.0, 5.0)))
        patch.setattr(module, "VARIANTS", VARIANTS[-1:])
        patch.setattr(reconstruct, "CAMERAS", ("narrow",))
        patch.setattr(reconstruct, "N_TRAINING", 6)
        yield


@pytest.fixture(scope="module")
def report(tiny, tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduce")
    seen = []
    return out, reproduce(out, size="tiny", progress=lambda done, total, what: seen.append((done, total))), seen


def test_the_page_holds_claims_figures_and_choices(report):
    out, verdicts, _ = report
    page = (out / "report.html").read_text()
    assert all(claim.text in page for claim in CLAIMS)
    assert list(verdicts) == ["generated scenes", VARIANTS[-1].what, module.VARIANCE_READING]
    assert {claim.name for claim in CLAIMS} - {"angle"} == set(verdicts["generated scenes"])  # two values, no trend
    assert page.count("data:image/png;base64,") == 6 + 2
    assert "figure.png" not in page
    assert not re.search(r'(src|href)="(?!#|data:)', page), "the page has to stand alone"
    words = re.findall(r"class='(yes|no)'", page)
    assert words.count("no") == sum(not v.holds for column in verdicts.values() for v in column.values())
    assert "strength of the simulated shadow is not given" in page
    assert "full shadow leaves 0.28, 0.22, 0.44 of the light" in page


def test_progress_counts_all_tasks_once(report):
    seen = report[2]
    total = seen[0][1]
    assert {t for _, t in seen} == {total}
    assert seen[-1][0] == total
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_finished_experiments_are_not_done_again(report, monkeypatch):
    out, verdicts, _ = report
    monkeypatch.setattr(module, "run_experiment", lambda *_: pytest.fail("done again"))
    assert reproduce(out, size="tiny") == verdicts


def test_a_changed_or_broken_summary_is_done_again(report, monkeypatch):
    out, _, _ = report
    path = out / "scenes" / "bound" / "summary.json"
    kept = path.read_text()
    done = []
    run = module.run_experiment
    monkeypatch.setattr(
        module, "run_experiment", lambda experiment, *rest: (done.append(experiment.name), run(experiment, *rest))[1]
    )
    for text in ("{", json.dumps({**json.loads(kept), "fingerprint": "other"})):
        path.write_text(text)
        reproduce(out, size="tiny")
        assert path.read_text() == kept
    assert done == ["bound", "bound"]


def test_a_size_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(LiaamError, match="unknown size 'huge'; choose from quick, full"):
        reproduce(tmp_path, size="huge")


def test_real_pictures_get_their_own_parts(tiny, persons_of_two, tmp_path):
    folders = {part.folder for part in plan(None, persons_of_two, "tiny", 0)}
    assert {"persons/spot", "persons/convergence", "persons/reconstruct", "scenes/noise"} <= folders


@pytest.fixture(scope="module")
def persons_of_two(tmp_path_factory):
    from setups import write_person

    folder = tmp_path_factory.mktemp("persons")
    for person in (3, 4):
        write_person(folder, person)
    return folder
