"""What the studio does on its own: fit new pictures, and look for slips."""

import threading
import time
from functools import lru_cache
from pathlib import Path

import pytest
from small_projects import POINTS, by_name, put, states

from liaam import datasets
from liaam.fitting import Fitter
from liaam.io import Landmarks, read_image, read_landmarks, write_image, write_landmarks
from liaam.studio.background import Background
from liaam.studio.model_store import MODEL_FILE, ModelStore, is_set_aside, load_studio_model, set_aside
from liaam.studio.project import Project
from liaam.studio.training import Trainer, Training

FACE = Path(datasets.__file__).with_name("pictures") / "face" / "lisa.jpg"


@pytest.fixture
def faces(tmp_path):
    """Give a folder of two photographs of a face: upright, and of half the brightness."""
    folder = tmp_path / "faces"
    folder.mkdir()
    image = read_image(FACE)
    write_image(folder / "a.png", image)
    write_image(folder / "b.png", image // 2)
    return folder


@lru_cache
def fitter_of(model) -> Fitter:
    """Prepare a model once for all folders here, which takes longer than a fit."""
    return Fitter(model)


@pytest.fixture
def begin():
    """Give a function that makes the background of a folder, and the events that it tells."""

    def begin(folder, model=None):
        project, models, told = Project(folder), ModelStore(), []
        if model is not None:
            models.publish(model, {"source": "file", "trained": None, "pictures": {}})
        trainer = Trainer(project, models, lambda *event: told.append(event))
        background = Background(project, models, trainer, lambda *event: told.append(event))
        background._fitter_of = fitter_of
        return background, told

    return begin


def test_new_pictures_are_fitted_with_the_model_of_the_folder(folder, head_model, begin):
    background, told = begin(folder(3, 1), head_model)
    background.fit_new()
    pictures = background.project.overview().pictures
    assert [picture["state"] for picture in pictures] == ["done", "proposed", "proposed"]
    assert all(0 <= picture["quality"] <= 1 for picture in pictures[1:])
    assert ("fitting", {"done": 2, "total": 2}) in told and told[-2] == ("fitting", None)
    told.clear()
    background.fit_new()  # nothing is fitted twice
    assert told == []


def test_in_an_empty_folder_the_face_model_is_lent_until_it_is_declined(tmp_path, begin):
    background, told = begin(tmp_path)
    background.fit_new()
    models, project = background.models, background.project
    assert (models.own, models.current.facts["source"]) == (None, "face")
    assert told == [("project", {})] and project.templates.current is None
    background.decline()
    assert models.current is None


def test_in_a_folder_of_faces_the_face_model_proposes(faces, begin):
    background, _ = begin(faces)
    background.fit_new()
    project = background.project
    assert states(project) == {"a.png": "proposed", "b.png": "proposed"}
    assert project.templates.is_offered and background.models.current.facts["source"] == "face"
    assert not project.templates.is_own
    marks = project.marks("a.png")
    put(project, "a.png", marks["points"], marks["revision"])  # accepted
    assert read_landmarks(faces / "a.ljson").names == project.templates.current.names
    again, _ = begin(faces)  # after a restart
    assert not again.project.templates.is_own
    write_image(faces / "c.png", read_image(FACE)[:, ::-1])
    again.fit_new()
    assert states(again.project) == {"a.png": "done", "b.png": "proposed", "c.png": "proposed"}


def test_a_person_goes_back_to_the_face_model_from_one_that_was_trained_here(faces, begin, head_model):
    background, _ = begin(faces)
    background.fit_new()
    project, models = background.project, background.models
    marks = project.marks("a.png")
    put(project, "a.png", marks["points"], marks["revision"])
    assert not background.may_return  # it is in use
    head_model.save(project.store.path(MODEL_FILE))
    facts = {"trained": "2026-12-01", "pictures": {}, "order": project.templates.order}
    project.store.put("model", {MODEL_FILE: facts})
    load_studio_model(project, models)
    background.fit_new()
    assert models.current.facts["source"] == "studio" and background.may_return
    set_aside(project, models, True)
    background.fit_new()
    assert models.current.facts["source"] == "face" and states(project)["b.png"] == "proposed"
    restarted = ModelStore()
    load_studio_model(project, restarted)
    assert restarted.own is None and is_set_aside(project.store)
    set_aside(project, models, False)
    assert models.current.facts["source"] == "studio" and not is_set_aside(project.store)


def test_the_page_knows_while_faces_are_looked_for(faces, begin, monkeypatch):
    background, _ = begin(faces)
    looking = []
    monkeypatch.setattr(background, "_publish", lambda *event: looking.append(background.looking))
    assert background.looking is False
    background.fit_new()
    assert looking[0] is True or looking[1] is True
    assert background.looking is looking[-1] is False


def test_faces_can_be_declined_for_good(faces, begin):
    background, _ = begin(faces)
    background.fit_new()
    background.decline()
    for project in (background.project, Project(faces)):
        assert project.templates.current is None and states(project) == {"a.png": "new", "b.png": "new"}
    background.fit_new()
    assert background.models.current is None and background.project.templates.current is None


def test_own_points_replace_those_of_the_face_model(faces, begin):
    background, _ = begin(faces)
    background.fit_new()
    write_landmarks(faces / "b.pts", Landmarks(POINTS))
    background.fit_new()
    assert background.models.current is None and len(background.project.templates.current) == 3
    assert states(background.project) == {"a.png": "new", "b.png": "done"}


def test_without_faces_nothing_is_proposed(small, begin):
    (small.root / ".liaam-studio" / "studio.db").unlink()
    background, told = begin(small.root)
    background.fit_new()
    assert background.project.templates.current is None
    assert background.models.current is None  # the face model, which was lent before, would fit nothing here
    assert told == 4 * [("project", {})]  # it is lent, it looks for faces, it is not lent, it looks no longer


def test_exchanged_points_are_a_slip_until_a_person_checks_them(folder, begin):
    home = folder(8, 8)
    landmarks = read_landmarks(home / "p4.ljson")
    points = landmarks.points.copy()
    points[[33, 39]] = points[[39, 33]]
    write_landmarks(home / "p4.ljson", Landmarks(points, landmarks.contours))
    background, told = begin(home)
    background.check_landmarks()
    slips = {name: picture["slip"] for name, picture in by_name(background.project).items() if picture["slip"]}
    assert list(slips) == ["p4.png"] and "exchanged" in slips["p4.png"]
    assert {tuple(sorted(each["slip_points"])) for each in by_name(background.project).values()} == {(), (33, 39)}
    assert told == [("project", {})]
    background.check_landmarks()
    assert len(told) == 1
    background.project.review({"pictures": ["p4.png"], "did": "checked", "who": "Ann"})
    assert by_name(background.project)["p4.png"]["slip"] is None
    background.project.review({"pictures": ["p4.png"], "did": "unchecked", "who": "Ann"})
    assert by_name(background.project)["p4.png"]["slip"]
    write_landmarks(home / "p4.ljson", landmarks)
    assert by_name(background.project)["p4.png"]["slip"] is None  # not known of the new landmarks


def test_pictures_wait_for_the_model_of_a_training_and_not_for_its_measure(folder, head_model, begin):
    background, _ = begin(folder(3, 0), head_model)
    project, models = background.project, background.models

    def fitted_by():
        return {proposal["model"] for proposal in project.store.all("proposal").values()}

    background.fit_new()
    assert fitted_by() == {models.own.key}
    write_image(project.root / "q.png", read_image(FACE)[:, ::-1])
    background.trainer.state = Training("running")
    background.fit_new()  # a better model comes soon
    assert len(project.store.all("proposal")) == 3
    models.publish(head_model, {"source": "studio", "trained": "1", "pictures": {}})
    background.trainer.is_measuring = True
    background.fit_new()
    assert len(project.store.all("proposal")) == 4 and fitted_by() == {"1"}


def test_the_end_waits_for_the_fit_in_progress(folder, head_model, begin, monkeypatch):
    background, _ = begin(folder(2, 0), head_model)
    done, began = [], threading.Event()

    def work():
        began.set()
        time.sleep(0.2)
        done.append(1)

    monkeypatch.setattr(background, "fit_new", work)
    background.start()
    assert began.wait(60)
    background.stop()
    assert done and not background._thread.is_alive()
