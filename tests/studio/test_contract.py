"""The contract of the server and the page: its types for the page are up to date, and real answers keep it."""

import json
from types import UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

import pytest
from small_projects import POINTS, proposal, put

from liaam.studio import contract
from liaam.studio.sets import agreement, make_set
from making import studio_types


def faults(value: Any, kind: Any, where: str = "") -> list[str]:
    """Where a value of JSON differs from a type."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return []
    if origin in (Annotated, NotRequired):
        return faults(value, inner[0], where)
    if origin in (Union, UnionType):
        found = [faults(value, each, where) for each in inner]
        return [] if [] in found else min(found, key=len)
    if origin is Literal:
        return [] if value in inner else [f"{where}: {value!r}"]
    if is_typeddict(kind):
        return faults_of_object(value, kind, where)
    if origin is list:
        if not isinstance(value, list):
            return [f"{where}: {value!r}"]
        return [fault for i, each in enumerate(value) for fault in faults(each, inner[0], f"{where}[{i}]")]
    if origin is tuple:
        if len(value) != len(inner):
            return [f"{where}: {value!r}"]
        return [fault for each, one in zip(value, inner, strict=True) for fault in faults(each, one, where)]
    if origin is dict:
        return [fault for name, each in value.items() for fault in faults(each, inner[1], f"{where}.{name}")]
    kinds = (int, float) if kind is float else kind
    is_number = kind in (int, float) and isinstance(value, bool)
    return [] if isinstance(value, kinds) and not is_number else [f"{where}: {value!r}"]


def faults_of_object(value: Any, kind: Any, where: str) -> list[str]:
    if not isinstance(value, dict):
        return [f"{where}: {value!r}"]
    hints = get_type_hints(kind, include_extras=True)
    optional = {name for name, hint in hints.items() if "NotRequired" in str(hint)}
    found = [f"{where} lacks {name}" for name in hints.keys() - optional - value.keys()]
    found += [f"{where}.{name} is not in the contract" for name in value.keys() - hints.keys()]
    return found + [
        fault for name in value.keys() & hints.keys() for fault in faults(value[name], hints[name], f"{where}.{name}")
    ]


def sent(answer: Any) -> Any:
    """An answer as the page gets it."""
    return json.loads(json.dumps(answer, allow_nan=False))


def test_the_types_for_the_page_are_up_to_date():
    written = studio_types.PATH.read_text(encoding="utf-8")
    assert written == studio_types.typescript(), "run python -m making.studio_types"


def test_the_checker_finds_faults():
    assert faults({"indices": [1, "x"], "closed": 1, "more": 2}, contract.Contour) != []
    assert faults({"indices": []}, contract.Contour) == [" lacks closed"]
    assert faults({"indices": [1, 2], "closed": True}, contract.Contour) == []


def test_answers_of_a_folder_keep_the_contract(folder, serve):
    running = serve(folder(3, 2))
    project = running.client.get("/api/project").json()
    assert faults(project, contract.Project) == []
    assert (
        faults(running.client.get("/api/project", params={"stamp": project["stamp"]}).json(), contract.Unchanged) == []
    )
    marks = running.client.get("/api/pictures/p1.png/landmarks").json()
    assert faults(marks, contract.Marks) == []
    change = {key: marks[key] for key in ("points", "invisible", "absent", "origins", "revision")}
    change["points"][0] = [5.0, 6.0]
    assert faults(change, contract.SaveMarks) == []
    saved = running.client.put("/api/pictures/p1.png/landmarks", json=change).json()
    assert faults(saved, contract.Saved) == []
    assert faults(running.client.get("/api/pictures/p1.png/history").json(), list[contract.HistoryEntry]) == []
    did = {"pictures": ["p1.png", "p3.png"], "did": "checked"}
    assert faults(running.client.post("/api/review", json=did).json(), contract.Reviewed) == []


def test_refusals_and_events_keep_the_contract(folder, serve, monkeypatch):
    running = serve(folder(2, 1))
    told = []
    monkeypatch.setattr(running.studio.events, "publish", lambda kind, data: told.append((kind, sent(data))))
    address = "/api/pictures/p1.png/landmarks"
    marks = running.client.get(address).json()
    change = {key: marks[key] for key in ("points", "invisible", "revision")}
    change["points"][0] = [5.0, 6.0]
    assert running.client.put(address, json=change).status_code == 200
    change["points"][0] = [7.0, 8.0]
    template = {"names": ["a", "b", "c"], "contours": [], "mirror": None, "revision": "earlier"}
    refused = {
        "current": running.client.put(address, json=change),
        "folder": running.client.put(address, json=change | {"folder": "another"}),
        "template": running.client.put("/api/template", json=template),
        "error": running.client.get("/api/pictures/none.png/landmarks"),
    }
    for field, answer in refused.items():
        assert answer.status_code in (404, 409), field
        assert field in answer.json() and faults(answer.json(), contract.Fault) == []
    running.client.post("/api/review", json={"pictures": ["p1.png"], "did": "deleted"})
    assert {kind for kind, _ in told} == {"landmarks", "project"}
    assert [fault for kind, data in told for fault in faults(data, contract.EVENTS[kind])] == []


@pytest.mark.parametrize("state", ["new", "proposed", "accepted", "partial", "broken"])
def test_pictures_in_every_state_keep_the_contract(small, state):
    if state in ("proposed", "accepted"):
        small.add_proposals({"p1.png": proposal()})
    if state == "accepted":
        small.review({"pictures": ["p1.png"], "did": "accepted"})
    if state == "partial":
        put(small, "p1.png", [POINTS[0], None, POINTS[2]])
    if state == "broken":
        (small.root / "p1.png").write_bytes(b"rubbish")
    (picture, *_) = small.overview().pictures
    assert picture["state"] == ("done" if state == "accepted" else state)
    assert faults(sent(picture), contract.Picture) == []
    if state != "broken":
        assert faults(sent(small.marks("p1.png")), contract.Marks) == []


def test_the_agreement_keeps_the_contract(small):
    anna = small.of_set(make_set(small, {"name": "anna", "same": True})["name"])
    for project in (small, anna):
        put(project, "p1.png", POINTS)
    assert faults(sent(agreement(small)), contract.Agreement) == []


def test_the_model_keeps_the_contract(head_model):
    from liaam.studio.model_store import ModelStore, model_json

    facts = {"source": "studio", "trained": None, "pictures": {"a": "1"}, "left_out": {"a": "why"}}
    shown = model_json(ModelStore().publish(head_model, facts), {"a": "1"})
    assert faults(sent(shown), contract.Model) == []
