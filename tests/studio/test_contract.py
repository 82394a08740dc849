"""The contract of the server and the page: its types for the page are up to date, and real answers keep it."""

import inspect
import re
from dataclasses import fields
from types import NoneType
from typing import Any, get_type_hints

import pytest
from contract_checks import faults, sent
from small_projects import POINTS, proposal, put
from starlette.responses import Response
from starlette.routing import Route

from liaam.relighting import Lamp
from liaam.studio import contract
from liaam.studio.app import Studio, make_app
from liaam.studio.routes import agreed
from liaam.studio.sets import agreement, make_set
from making import studio_types


@pytest.fixture
def routes(tmp_path):
    """Give the routes of a studio below /api/, with their method."""
    studio = Studio(tmp_path)
    every = [each for each in make_app(studio).routes if isinstance(each, Route) and each.path.startswith("/api/")]
    yield [(method, each) for each in every for method in (each.methods or set()) - {"HEAD"}]
    studio.close()


def address_of(route):
    return re.sub(r":\w+}", "}", route.path.removeprefix("/api/"))


def test_the_routes_are_those_of_the_contract(routes):
    assert sorted(f"{method} {address_of(route)}" for method, route in routes) == sorted(contract.ROUTES)


def test_functions_take_and_answer_what_the_contract_says_of_their_routes(routes):
    for method, route in routes:
        endpoint = agreed(method, route.path)
        act = inspect.unwrap(route.endpoint)
        hints = get_type_hints(act, include_extras=True)
        # A file is sent as a response, and JSON is checked by what is called.
        assert hints["return"] == {bytes: Response, None: NoneType}.get(endpoint.answer, endpoint.answer), route.path
        if not inspect.iscoroutinefunction(act):  # which reads the request itself
            taken = [hints[name] for name in [*inspect.signature(act).parameters][1:]]
            body = {bytes: [bytes], None: []}.get(endpoint.body, [Any])
            assert taken == [*([endpoint.query] if endpoint.query else []), *body], route.path


def test_a_route_that_is_not_in_the_contract_cannot_be_made():
    with pytest.raises(KeyError):
        agreed("GET", "/api/pictures/{name:path}/colour")


def test_names_in_an_address_are_not_those_of_its_query():
    for route, endpoint in contract.ROUTES.items():
        asked = {field.name for field in fields(endpoint.query)} if endpoint.query else set()
        assert not asked & {*re.findall(r"{(\w+)}", route)}, route


def test_nothing_in_the_contract_is_of_any_type():
    code = re.sub(r"/\*\*.*?\*/", "", studio_types.typescript(), flags=re.DOTALL)
    assert re.findall(r".*\b(?:any|unknown|object)\b.*", code) == []


def test_lamps_are_sent_as_they_are():
    assert {field.name for field in fields(contract.SentLamp)} == {field.name for field in fields(Lamp)}


@pytest.mark.parametrize("data", [{}, {"points": None, "revision": None}])
def test_fields_that_a_request_lacks_are_none_or_left_out(data):
    asked = contract.given(contract.SaveMarks, {**data, "more": 1})
    assert asked == contract.SaveMarks(points=None, revision=None)  # type: ignore[arg-type]
    assert asked.bar is contract.OMITTED and asked.who is None


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
