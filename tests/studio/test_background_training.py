"""Training in its own process, on generated pictures."""

import json
import os
import shutil
import signal
import threading
from contextlib import contextmanager

import numpy as np
import pytest

from liaam.io import Landmarks, write_image, write_landmarks
from liaam.model import SURROUNDINGS, load_model
from liaam.studio.app import Studio
from liaam.studio.background import Background, proposal_of
from liaam.studio.folder import STATE
from liaam.studio.model_store import (
    ModelStore,
    load_studio_model,
    model_json,
)
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.training import Trainer

pytestmark = pytest.mark.slow


class Told:
    """What was published, and a way to wait for it."""

    def __init__(self):
        self.events = []
        self.changed = threading.Condition()

    def __call__(self, kind, data):
        with self.changed:
            self.events.append((kind, data))
            self.changed.notify_all()

    def wait_for(self, test):
        with self.changed:
            assert self.changed.wait_for(lambda: any(map(test, list(self.events))), 120)


@pytest.fixture
def setting(folder_of_objects):
    """Give what makes a trainer of a folder with so many pictures, so many of them done; ended at the end."""
    with trainers_in(folder_of_objects) as make:
        yield make


@pytest.fixture
def setting_of_faces(folder):
    """Give a like trainer of pictures of faces, on which training takes longer."""
    with trainers_in(folder) as make:
        yield make


@contextmanager
def trainers_in(folder):
    trainers = []

    def make(n, done):
        project, models, told = Project(folder(n, done)), ModelStore(), Told()
        trainers.append(Trainer(project, models, told))
        return project, models, told, trainers[-1]

    yield make
    for trainer in trainers:
        trainer.stop()


def shown(current, project):
    """What the page is told of a model."""
    overview = project.overview()
    return model_json(current, overview.done, sides=overview.sides)


def states(project):
    return [picture["state"] for picture in project.overview().pictures]


def test_training_places_the_points_of_the_other_pictures(setting_of_faces, portraits):
    project, models, told, trainer = setting_of_faces(8, 4)
    shutil.copy(project.root / "p8.png", project.root / "p9.png")
    (project.root / "p9.png").write_bytes((project.root / "p8.png").read_bytes()[:9000])  # its header is sound
    write_image(project.root / "p99.png", np.tile(np.uint8(90), (60, 80, 3)))
    background, seen = Background(project, models, trainer, told), []
    models.listeners.append(lambda current: seen.append(current.number))

    assert trainer.start().state == "running"
    with pytest.raises(Refusal, match="a training is running: wait for it, or stop it") as caught:
        trainer.start()
    assert caught.value.status == 409
    ended = trainer.wait(240)

    assert (ended.state, ended.error) == ("done", None)
    assert seen == [1]
    assert models.current.model.n_images == 4
    assert models.current.model.n_lamps > 0  # the model knows the lamps of rendered heads
    (version,) = trainer.versions.as_json(project.templates.order)
    assert (version["pictures"], version["held_out"]) == (4, 1) and 0 < version["error"] < 0.05
    background.fit_new()
    assert states(project)[:8] == ["done"] * 4 + ["proposed"] * 4
    for i in range(4, 8):
        marks, truth = project.marks(f"p{i + 1}.png"), portraits[i].landmarks
        error = np.linalg.norm(np.array(marks["points"]) - truth, axis=1).mean()
        size = np.hypot(*np.ptp(truth, axis=0))
        assert error < 0.03 * size
        assert np.array(marks["covariances"]).shape == (58, 2, 2)
    pictures = {picture["name"]: picture for picture in project.overview().pictures}
    assert sorted(pictures[f"p{i}.png"]["rank"] for i in range(5, 9)) == [1, 2, 3, 4]
    assert all(0 < pictures[f"p{i}.png"]["uncertainty"] < 0.2 for i in range(5, 9))
    assert pictures["p9.png"]["state"] == "new" and "cut short" in pictures["p9.png"]["error"]
    assert str(project.root) not in pictures["p9.png"]["error"]

    # What is there after a restart.
    again, store = Project(project.root), ModelStore()
    load_studio_model(again, store)
    assert states(again) == states(project)
    told_of = shown(store.current, again)
    assert (told_of["stale"], told_of["source"], told_of["n_points"]) == (0, "studio", 58)
    assert told_of["trained"] == models.current.facts["trained"]
    json.dumps(told_of, allow_nan=False)
    marks = again.marks("p5.png")
    again.save_marks("p5.png", marks)
    assert shown(store.current, again)["stale"] == 1
    assert not shown(store.current, again)["sides_changed"]
    again.save_sides({"sides": {"p2.png": "left"}})
    assert shown(store.current, again)["sides_changed"]
    again.templates.order = "another"  # as after a change of the points
    Trainer(again, store, lambda *_: None).follow_template()
    assert store.current is None and not (again.root / STATE / "model.liaam").exists()
    (kept,) = (again.root / STATE / "kept").glob("model.*.liaam")
    assert load_model(kept).n_points == 58


def test_a_fault_in_the_server_ends_the_training(setting, caplog):
    _, models, _, trainer = setting(5, 4)

    def fail(_):
        raise ValueError("a bug")

    models.listeners.append(fail)
    trainer.start()
    ended = trainer.wait(120)
    assert (ended.state, "the training failed (ValueError)" in ended.error) == ("failed", True)
    assert "a bug" in caplog.text


def test_too_few_pictures_are_refused(setting):
    *_, trainer = setting(4, 2)
    with pytest.raises(Refusal, match="only 2 pictures have all their points: complete at least 3") as caught:
        trainer.start()
    assert caught.value.status == 422
    assert trainer.state.state == "idle"


def test_stopping_ends_the_process_and_keeps_what_was_there(setting):
    project, _, told, trainer = setting(5, 4)
    trainer.start()
    process = trainer._process
    told.wait_for(lambda event: event[0] == "training" and event[1]["total"] > 0)
    assert trainer.stop().state == "idle"
    assert not process.is_alive()
    trainer.wait(60)
    assert trainer.state.state == "idle"
    assert project.problems == []
    assert trainer.start().state == "running"  # and again
    trainer.stop()


def wait_for_the_model(told):
    told.wait_for(lambda event: event[0] == "project")


def test_a_training_that_is_stopped_leaves_the_earlier_model_in_place(setting):
    project, models, told, trainer = setting(5, 4)
    trainer.start()
    assert trainer.wait(240).state == "done"
    before, data = models.current, (project.root / STATE / "model.liaam").read_bytes()
    assert shown(before, project)["stale"] == 0
    Background(project, models, trainer, told).fit_new()
    project.save_marks("p5.png", project.marks("p5.png"))
    told.events.clear()
    trainer.start()
    told.wait_for(lambda event: event[0] == "training" and event[1]["total"] > 0)
    trainer.stop()
    assert models.current is before
    assert (project.root / STATE / "model.liaam").read_bytes() == data
    assert shown(models.current, project)["stale"] == 1
    store = ModelStore()
    load_studio_model(Project(project.root), store)
    assert store.current.facts["trained"] == before.facts["trained"]


def test_a_model_is_used_while_it_is_measured_and_stays_if_that_is_stopped(setting_of_faces):
    project, models, told, trainer = setting_of_faces(6, 4)  # measured for long enough to be stopped
    trainer.start()
    wait_for_the_model(told)
    assert trainer.is_measuring and trainer.state.state == "running"
    trainer.stop()
    again, store = Project(project.root), ModelStore()
    load_studio_model(again, store)
    for current in (models.current, store.current):
        assert current.model.views[SURROUNDINGS].reliabilities
        assert shown(current, again)["stale"] == 0
    assert trainer.versions.as_json(project.templates.order) == []


def test_a_model_of_points_in_another_order_is_not_taken_up_again(setting):
    project, models, told, trainer = setting(5, 4)
    trainer.start()
    wait_for_the_model(told)
    trainer.stop()
    names = project.templates.current.names
    order = [*range(1, len(names)), 0]
    project.save_template({"names": [names[i] for i in order], "mapping": order})
    store = ModelStore()
    load_studio_model(Project(project.root), store)
    assert store.current is None
    trainer.follow_template()
    assert models.current is None and not (project.root / STATE / "model.liaam").exists()


def test_stopping_what_does_not_run_changes_nothing(setting):
    *_, trainer = setting(3, 0)
    assert trainer.stop().state == "idle"


def test_a_process_that_is_killed_is_told(setting):
    *_, told, trainer = setting(5, 4)
    trainer.start()
    told.wait_for(lambda event: event[0] == "training" and event[1]["total"] > 0)
    os.kill(trainer._process.pid, signal.SIGKILL)
    ended = trainer.wait(60)
    assert ended.state == "failed" and "ended unexpectedly" in ended.error


def is_trained_on(model, name):
    return name in model.facts["pictures"].keys() - model.facts["left_out"]


def test_pictures_with_absent_points_are_trained_on_and_measured(setting):
    project, models, _, trainer = setting(5, 5)
    for i in range(1, 6):
        marks = project.marks(f"p{i}.png")
        absent = [i] if i == 1 else [i, 6]  # one of them has the point
        marks["points"] = [None if j in absent else point for j, point in enumerate(marks["points"])]
        project.save_marks(f"p{i}.png", {**marks, "absent": absent, "origins": None})
    assert states(project) == ["done"] * 5
    assert [item.placed.sum() for item in project.annotated()] == [7, 6, 6, 6, 6]
    own, not_own = project.own_complete()
    assert (own, not_own) == ({}, [])  # comparisons need all points
    trainer.start()
    ended = trainer.wait(240)
    assert (ended.state, ended.error) == ("done", None)
    assert "landmark 7 is placed in only 1 of 5 images" in ended.what
    model = models.current.model
    assert model.n_images == 5 and models.current.facts["left_out"] == {}
    assert model.n_missing[6] == 4 and model.n_missing[1:6].tolist() == [1] * 5
    (version,) = trainer.versions.as_json(project.templates.order)
    assert version["held_out"] == 1 and 0 < version["error"] < 0.1


def test_possible_slips_are_left_out_unless_a_person_wants_them(setting):
    project, models, _, trainer = setting(4, 4)
    (first, *_), slip = project.annotated(), "points 1–2 are exchanged"
    project.set_slips({first.name: (first.revision, slip, [0, 1])})
    trainer.start()
    trainer.wait()
    assert models.current.facts["left_out"] == {first.name: f"its points may be wrong: {slip}"}
    assert not is_trained_on(models.current, first.name)
    assert models.current.model.n_all_images == 3
    assert shown(models.current, project)["stale"] == 0  # it is no reason to train again
    trainer.start(slips=True)
    trainer.wait()
    assert is_trained_on(models.current, first.name)
    project.review({"pictures": [first.name], "did": "checked"})
    assert project.annotated()[0].slip is None


def test_pictures_that_do_not_serve_are_left_out(setting):
    from liaam.io import read_image, write_image

    project, models, _, trainer = setting(6, 6)
    (project.root / "p1.png").write_bytes((project.root / "p1.png").read_bytes()[:9000])
    write_image(project.root / "p2.png", read_image(project.root / "p2.png").astype(np.uint16) * 16)
    trainer.start()
    ended = trainer.wait(240)
    assert ended.state == "done", ended
    assert models.current.model.n_images == 4
    assert "cut short" in models.current.facts["left_out"]["p1.png"]
    assert "multiply 12-bit values by 16" in models.current.facts["left_out"]["p2.png"]


def test_pictures_whose_points_fold_the_mesh_are_left_out_with_the_reason(setting):
    project, models, _, trainer = setting(4, 4)
    write_landmarks(project.root / "p2.ljson", Landmarks(project.landmarks("p2.png").points[::-1]))
    trainer.start()
    assert trainer.wait(240).state == "done"
    assert models.current.model.n_all_images == 3
    assert list(models.current.facts["left_out"]) == ["p2.png"]
    assert "its points fold the mesh" in models.current.facts["left_out"]["p2.png"]
    assert shown(models.current, project)["left_out"].keys() == {"p2.png"}
    assert shown(models.current, project)["stale"] == 0  # it is no reason to train again


def test_accuracy_counts_no_points_that_were_accepted_as_they_were_proposed(setting):
    project, _, _, trainer = setting(6, 4)
    for i in range(1, 5):
        marks = project.marks(f"p{i}.png")
        project.save_marks(f"p{i}.png", {**marks, "origins": ["accepted"] * len(marks["points"])})
    trainer.start()
    assert trainer.wait(240).state == "done"
    assert trainer.versions.as_json(project.templates.order) == []  # nothing to measure on


def test_grey_pictures_are_learnt_from_and_named(setting):
    from liaam.io import read_image

    project, models, _, trainer = setting(5, 5)
    write_image(project.root / "p2.png", read_image(project.root / "p2.png").mean(axis=2).astype(np.uint8))
    trainer.start()
    ended = trainer.wait(240)
    assert ended.state == "done", ended
    assert models.current.model.n_images == 5 and models.current.model.is_colour
    assert "1 of 5 images is grey (p2.png)" in ended.what


def test_what_cannot_be_learnt_from_is_told(setting):
    project, models, _, trainer = setting(3, 3)
    points = project.landmarks("p2.png").points
    write_landmarks(project.root / "p2.ljson", Landmarks(points[::-1]))
    trainer.start()
    ended = trainer.wait(120)
    assert ended.state == "failed" and "1 of 3 images fold the mesh" in ended.error and "p2.png (" in ended.error
    assert models.current is None


def test_a_damaged_model_is_told_and_passed_over(folder):
    project, models = Project(folder(3, 3)), ModelStore()
    for data in (b"", b"rubbish" * 100):
        project.store.path("model.liaam").write_bytes(data)
        load_studio_model(project, models)
        assert models.current is None
        assert any("model.liaam" in problem and "train again" in problem for problem in project.problems)


def test_a_model_without_its_facts_still_serves(folder, head_model):
    project, models = Project(folder(3, 3)), ModelStore()
    head_model.save(project.store.path("model.liaam"))
    project.store.put("model", {"model.liaam": None})
    load_studio_model(project, models)
    assert models.current.facts["trained"] is None
    assert shown(models.current, project)["stale"] == 3


def test_a_given_model_serves(folder, head_model, tmp_path):
    head_model.save(tmp_path / "m.liaam")
    studio = Studio(folder(2), tmp_path / "m.liaam")
    assert shown(studio.models.current, studio.project)["source"] == "file"
    studio.close()


def test_a_fit_that_blew_up_is_no_proposal(head_model, moving):
    from dataclasses import replace

    from liaam.fitting import Fitter

    result = Fitter(head_model).fit(moving[0].image, moving[0].landmarks)
    sound = proposal_of(result)
    assert sound["ok"] and not sound["doubtful"] and sound["uncertainty"] > 0
    blown = proposal_of(replace(result, landmarks=np.full_like(result.landmarks, np.nan)))
    assert blown["points"] is None and blown["message"]
    unsure = proposal_of(replace(result, landmark_covariances=np.full((len(result.landmarks), 2, 2), np.inf)))
    assert unsure["uncertainty"] is None and unsure["covariances"] is None and unsure["points"]
    json.dumps([sound, blown, unsure], allow_nan=False)
