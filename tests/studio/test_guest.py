"""Models of others: dropped on the page, or of the generated heads; and the generated heads themselves."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from liaam.datasets.heads import HARD_LIGHT, SOFT_LIGHT
from liaam.fitting.held import methods_of
from liaam.studio.generated import CALIBRATION, trained
from liaam.studio.model_store import ModelStore, model_json
from liaam.studio.safety import GUEST, UPLOADS


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
    guest = models.receive(head_model, "kate")
    own = models.publish(head_model, {"source": "studio", "trained": None, "pictures": {}})
    assert (models.current, models.own) == (guest, own)
    models.dismiss()
    assert models.current is own
    assert told == [guest, guest, own]
    assert model_json(guest, {"p1.png": "1"})["source"] == "guest"


# The generated heads


def test_the_heads_are_offered_and_their_model_is_made(page):
    answer = page.client.get("/api/heads").json()
    assert [page.client.get(f"/{path}").headers["content-type"] for path in answer["pictures"]] == 6 * ["image/jpeg"]
    assert page.client.post("/api/heads/model", json={}).status_code == 204
    assert model_of(page)["name"] == "generated heads"


def test_all_heads_are_fitted_well(page):
    page.client.post("/api/heads/model", json={})
    fits = []
    for path in sorted(HARD_LIGHT.glob("*.jpg")):
        upload = page.client.post(UPLOADS, params={"name": path.name}, content=path.read_bytes()).json()["id"]
        fits.append(page.client.post("/api/fits", json={"upload": upload}).json())
    assert len(fits) == 6
    assert all(fit["ok"] and fit["quality"] > 0.8 and "flat" in fit["layers"] for fit in fits)


@pytest.mark.slow
def test_the_calibration_is_that_of_the_pictures():
    """It is stored, because measuring it takes long. If this fails: python -m docs.figures.make_generated_heads."""
    known, made = json.loads(CALIBRATION.read_bytes()), trained(calibrate=True).views["surroundings"].reliability
    assert known.keys() == asdict(made).keys()
    for name, value in asdict(made).items():
        np.testing.assert_allclose(value, known[name], rtol=0.05, atol=0.05, err_msg=name)


def test_the_files_are_small():
    files = [*SOFT_LIGHT.iterdir(), *HARD_LIGHT.iterdir(), CALIBRATION]
    assert sum(file.stat().st_size for file in files) < 700_000
