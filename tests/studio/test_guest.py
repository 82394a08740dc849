"""Models of others, dropped on the page, and the one that comes with liaam."""

import pytest

from liaam.fitting.methods import methods_of
from liaam.studio.model_store import ModelStore, model_json
from liaam.studio.safety import GUEST


@pytest.fixture
def page(serve, tmp_path, head_model):
    """Give a studio on an empty folder, whose own model is the head model."""
    path = tmp_path / "own.liaam"
    head_model.save(path)
    folder = tmp_path / "empty"
    folder.mkdir()
    return serve(folder, path)


def model_of(page) -> dict:
    return page.client.get("/api/project").json()["model"]


def test_a_guest_is_used_until_it_leaves(page, head_model):
    own = model_of(page)
    assert own["source"] == "file"
    data = page.client.get("/api/model/file").content
    assert page.client.post(GUEST, params={"name": "kate.liaam"}, content=data).status_code == 204
    guest = model_of(page)
    assert (guest["source"], guest["name"], guest["n_points"]) == ("guest", "kate", head_model.n_points)
    assert guest["number"] > own["number"]
    assert tuple(guest["methods"]) == methods_of(head_model)
    assert page.client.delete(GUEST).status_code == 204
    assert model_of(page) == own


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda data: b"", "not a complete liaam model"),
        (lambda data: b"\x89PNG\r\n", "not a complete liaam model"),
        (lambda data: data[: len(data) // 2], "not a complete liaam model"),
        (lambda data: data.replace(b"liaam-aam", b"liaam-zzz", 1), "model"),
        (lambda data: data.replace(b"n_images", b"n_imagez", 1), "model"),
    ],
)
def test_a_broken_model_is_refused_and_the_former_stays(page, change, fault):
    before = model_of(page)
    data = page.client.get("/api/model/file").content
    answer = page.client.post(GUEST, params={"name": "odd/kate.liaam"}, content=change(data))
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("kate.liaam: ")
    assert fault in answer.json()["error"]
    assert "/tmp" not in answer.json()["error"]
    assert model_of(page) == before


def test_too_large_models_are_refused(serve, tmp_path, head_model):
    page = serve(tmp_path, upload_bytes=1000, points=10)
    assert page.client.post(GUEST, content=bytes(1001)).status_code == 413
    page = serve(tmp_path.parent, points=10)
    answer = page.client.post(GUEST, params={"name": "k.liaam"}, content=head_model.to_bytes())
    assert answer.status_code == 422
    assert f"k.liaam has {head_model.n_points} points, more than the 10" in answer.json()["error"]


def test_a_training_that_ends_does_not_replace_a_guest(head_model):
    models, told = ModelStore(), []
    models.listeners.append(told.append)
    guest = models.publish(head_model, {"source": "guest", "trained": None, "pictures": {}, "name": "kate"}, "guest")
    own = models.publish(head_model, {"source": "studio", "trained": None, "pictures": {}})
    assert (models.current, models.own) == (guest, own)
    models.publish(None, place="guest")
    assert models.current is own
    assert told == [guest, guest, own]
    assert model_json(guest, {"p1.png": "1"})["source"] == "guest"


def test_a_spare_model_is_used_while_there_is_no_other(head_model):
    models = ModelStore()
    models.publish(head_model, {"source": "face", "trained": None, "pictures": {}}, "spare")
    spare = models.current
    assert (spare.facts["source"], models.own) == ("face", None)
    assert models.publish(head_model, {"source": "studio", "trained": None, "pictures": {}}) is models.current
    models.publish(None)
    assert models.current is spare
    models.publish(None, place="spare")
    assert models.current is None
