"""The studio's server: what the page asks for, in the order in which a person works."""

import json
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
from small_projects import browser_of

from liaam.errors import ImageError, LiaamError
from liaam.io import Landmarks, read_landmarks, write_image, write_landmarks
from liaam.model import load_model
from liaam.relighting.lamp import AMBIENT
from liaam.studio.project import Project
from liaam.studio.serving import open_port, serve as serve_until_interrupted


class Listener:
    """A page that listens to the server's events."""

    def __init__(self, running):
        self.connection = socket.create_connection(("127.0.0.1", running.port), 60)
        token = running.studio.settings.token
        lines = [f"Host: 127.0.0.1:{running.port}", f"Authorization: Bearer {token}"]
        self.connection.sendall("\r\n".join(["GET /api/events HTTP/1.1", *lines, "", ""]).encode())
        self.stream = self.connection.makefile("rb")
        assert self.line_with(b"retry:")

    def line_with(self, text: bytes) -> bytes:
        """Wait for a line that holds a text; empty at the end of the stream."""
        for line in self.stream:
            if text in line:
                return line
        return b""

    def event(self, kind: str):
        """Wait for an event; gives its data."""
        assert self.line_with(f"event: {kind}".encode())
        return json.loads(self.line_with(b"data: ").removeprefix(b"data: "))


@pytest.fixture
def listen():
    listeners = []

    def start(running):
        listeners.append(Listener(running))
        return listeners[-1]

    yield start
    for listener in listeners:
        listener.stream.close()
        listener.connection.close()


def test_the_project_is_described(folder, serve):
    running = serve(folder(4, 3))
    answer = running.client.get("/api/project").json()
    assert answer["folder"] == "project"
    assert [picture["state"] for picture in answer["pictures"]] == ["done"] * 3 + ["new"]
    assert len(answer["template"]["names"]) == 58 and len(answer["template"]["contours"]) == 2
    assert answer["model"] is None and answer["problems"] == []
    assert answer["training"] == {
        "state": "idle", "done": 0, "total": 0, "what": "", "error": None,
    }  # fmt: skip
    assert answer["default_method"] in {method["name"] for method in answer["methods"]}
    assert answer["default_ambient"] == AMBIENT
    assert answer["limits"] == {"upload_bytes": 64_000_000, "pixels": 200_000_000, "relit_pixels": 16_000_000}


def test_an_empty_folder_has_an_empty_page(folder, serve):
    running = serve(folder(0))
    assert running.client.get("/api/project").json()["pictures"] == []
    page = running.client.get("/")
    assert page.status_code == 200 and page.headers["content-type"].startswith("text/html")
    assert running.client.get("/style.css").headers["content-type"].startswith("text/css")
    assert "javascript" in running.client.get("/js/main.js").headers["content-type"]


def test_pictures_are_given_once(folder, serve):
    client = serve(folder(1)).client
    for what in ("image?size=100", "image?size=160", "chroma?size=64"):
        answer = client.get(f"/api/pictures/p1.png/{what}")
        assert answer.status_code == 200
        again = client.get(f"/api/pictures/p1.png/{what}", headers={"if-none-match": answer.headers["etag"]})
        assert again.status_code == 304 and not again.content
    assert client.get("/api/pictures/p2.png/image").status_code == 404
    assert client.get("/api/pictures/p1.png/image?size=x").status_code == 422


def test_a_picture_that_cannot_be_decoded_is_told_unless_training_will_do_so(folder, serve):
    root = folder(3, 1)
    for name in ("p1.png", "p2.png"):
        (root / name).write_bytes((root / name).read_bytes()[:9000])  # the header is whole
    client = serve(root).client
    for name in ("p1.png", "p2.png"):
        assert client.get(f"/api/pictures/{name}/image?size=160").status_code == 422
    first, second, third = client.get("/api/project").json()["pictures"]
    assert [picture["state"] for picture in (first, second, third)] == ["done", "broken", "new"]
    assert "cut short" in second["error"]


def test_a_picture_that_is_away_for_a_moment_is_not_unreadable_for_good(folder):
    project = Project(folder(1, 0))
    source, path = project.source("p1.png"), project.root / "p1.png"
    path.rename(path.with_suffix(".away"))
    project.mark_unreadable(source, ImageError("p1.png cannot be read"))
    path.with_suffix(".away").rename(path)
    assert project.overview().pictures[0]["state"] == "new"


def test_a_picture_that_the_system_cannot_read_now_may_be_read_later(folder):
    project = Project(folder(1, 0))
    fault = ImageError("p1.png cannot be read (Too many open files)")
    fault.__cause__ = ImageError("it cannot be opened")
    fault.__cause__.__cause__ = OSError(24, "Too many open files")
    project.mark_unreadable(project.source("p1.png"), fault)
    assert project.overview().pictures[0]["state"] == "new"
    project.mark_unreadable(project.source("p1.png"), ImageError("p1.png is cut short"))
    assert project.overview().pictures[0]["state"] == "broken"


def test_landmarks_are_saved_and_other_pages_told(folder, serve, listen):
    running = serve(folder(2))
    page = listen(running)
    client = running.client
    template = {"names": ["a", "b", "c"], "contours": [{"indices": [0, 1, 2], "closed": True}], "mirror": None}
    saved = client.put("/api/template", json=template).json()
    assert saved == {**template, "points": None, "kinds": ["landmark"] * 3, "revision": saved["revision"]}
    assert page.event("project") == {}
    marks = {"points": [[1, 2], [30, 2], None], "invisible": [], "revision": None}
    answer = client.put("/api/pictures/p1.png/landmarks", json=marks).json()
    assert (answer["picture"]["state"], answer["picture"]["placed"]) == ("partial", 2)
    told = {"name": "p1.png", "revision": answer["revision"], "beside": answer["beside"]}
    assert page.event("landmarks") == told
    clash = client.put("/api/pictures/p1.png/landmarks", json={**marks, "points": [[5, 5], None, None]})
    assert clash.status_code == 409
    assert clash.json()["current"] == client.get("/api/pictures/p1.png/landmarks").json()
    assert clash.json()["current"]["points"] == marks["points"]


def test_pictures_are_reviewed_and_exported_and_other_pages_told(folder, serve, listen):
    running = serve(folder(3, 3))
    page = listen(running)
    body = {"pictures": ["p1.png", "p2.png"], "did": "deleted", "who": "Ann"}
    assert running.client.post("/api/review", json=body).json() == {"changed": ["p1.png", "p2.png"], "refused": {}}
    assert page.event("landmarks") == [{"name": name, "revision": ""} for name in ("p1.png", "p2.png")]
    assert page.event("project") == {}
    (entry,) = running.client.get("/api/pictures/p1.png/history").json()
    assert (entry["did"], entry["who"]) == ("deleted", "Ann")
    assert running.client.post("/api/review", json={**body, "folder": "another"}).status_code == 409
    answer = running.client.get("/api/export/tps")
    assert answer.headers["content-disposition"].startswith("attachment") and "x-both-sides" not in answer.headers
    assert answer.text.count("IMAGE=p3.png") == answer.text.count("IMAGE=") == 1


def test_a_template_is_read_from_a_file(folder, serve):
    client = serve(folder(1)).client
    answer = client.post("/api/template/file?name=x.tem", content=b"3\n1 3\n20 3\n10 15\n1\n1 3 0 1 2\n")
    assert answer.status_code == 200
    assert answer.json()["contours"] == [{"indices": [0, 1, 2], "closed": True}]
    assert client.get("/api/project").json()["template"] is None
    bad = client.post("/api/template/file?name=x.tem", content=b"3\n1 3\n")
    assert bad.status_code == 422 and bad.json()["error"].startswith("x.tem")
    assert client.post("/api/template/file?name=x.exe", content=b"MZ").status_code == 422


@pytest.mark.slow
def test_training_runs_and_is_told(folder_of_objects, serve, listen):
    running = serve(folder_of_objects(5, 4))
    client, page = running.client, listen(running)
    assert client.get("/api/model/file").status_code == 404
    assert client.post("/api/training", json={}).status_code == 202
    assert client.post("/api/training").status_code == 409
    while (state := page.event("training"))["state"] == "running":
        pass
    assert state["state"] == "done"
    running.studio.background.fit_new()  # whose thread was not started
    project = client.get("/api/project").json()
    assert project["model"]["n_images"] == 4 and project["model"]["source"] == "studio"
    assert project["pictures"][4]["state"] == "proposed" and project["pictures"][4]["rank"] == 1
    file = client.get("/api/model/file")
    assert file.headers["content-disposition"].startswith("attachment")
    path = running.studio.project.root / "copy.liaam"
    path.write_bytes(file.content)
    assert load_model(path).n_points == 8
    # A point less: the model does not fit any more.
    template = project["template"]
    mapping = list(range(7))
    change = {"names": template["names"][:7], "contours": [], "mirror": None, "points": None, "mapping": mapping}
    assert client.put("/api/template", json=change).status_code == 200
    project = client.get("/api/project").json()
    assert project["model"] is None and project["pictures"][4]["state"] == "new"
    assert client.get("/api/pictures/p1.png/landmarks").json()["points"][6] is not None


def test_training_is_stopped(folder_of_objects, serve):
    client = serve(folder_of_objects(5, 4)).client
    client.post("/api/training", json={})
    assert client.delete("/api/training").json()["state"] == "idle"
    assert client.delete("/api/training").status_code == 200
    assert client.get("/api/project").json()["training"]["state"] == "idle"


def test_too_few_pictures_are_told(folder, serve):
    answer = serve(folder(3, 2)).client.post("/api/training", json={})
    assert answer.status_code == 422 and "complete at least 3" in answer.json()["error"]


def test_a_given_model_is_used(folder, serve, head_model, tmp_path):
    head_model.save(tmp_path / "m.liaam")
    running = serve(folder(1), tmp_path / "m.liaam")
    assert running.client.get("/api/project").json()["model"]["source"] == "file"


def test_damaged_files_of_the_studio_do_not_stop_it(folder, serve):
    home = folder(3, 3)
    (home / ".liaam-studio").mkdir()
    for name in ("studio.db", "model.liaam"):
        (home / ".liaam-studio" / name).write_bytes(b'{"half')
    project = serve(home).client.get("/api/project").json()
    assert [picture["state"] for picture in project["pictures"]] == ["done"] * 3
    assert len(project["problems"]) == 2


def test_errors_are_json_that_says_what_to_do(folder, serve):
    client = serve(folder(1)).client
    for method, path, status in (
        ("GET", "/api/nothing", 404),
        ("GET", "/api/pictures/x.png/landmarks", 404),
        ("DELETE", "/api/project", 405),
        ("GET", "/nothing.html", 404),
        ("PUT", "/api/template", 415),
    ):
        answer = client.request(method, path)
        assert answer.status_code == status
        assert answer.json()["error"]


def test_a_fault_of_the_program_is_told_without_its_insides(folder, serve, monkeypatch, caplog):
    running = serve(folder(1))

    def fail(name):
        raise RuntimeError("inner secret")

    monkeypatch.setattr(running.studio.project, "marks", fail)
    answer = running.client.get("/api/pictures/p1.png/landmarks")
    assert answer.status_code == 500
    assert "RuntimeError" in answer.json()["error"] and "inner secret" not in answer.text
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert running.client.get("/api/project").status_code == 200
    running.stop()
    assert "inner secret" in caplog.text  # the terminal tells


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_a_file_that_cannot_be_read_is_no_refused_write(folder, serve, monkeypatch, method):
    running = serve(folder(1))

    def fail(name):
        raise LiaamError("p1.png cannot be read") from PermissionError(13, "denied")

    monkeypatch.setattr(running.studio.project, "marks", fail)
    assert running.client.request(method, "/api/pictures/p1.png/landmarks").status_code == 422


def test_a_folder_that_goes_away_is_told(folder, serve):
    home = folder(1)
    running = serve(home)
    home.rename(home.with_name("elsewhere"))
    answer = running.client.get("/api/project")
    assert answer.status_code == 503 and "is the folder still there?" in answer.json()["error"]
    home.with_name("elsewhere").rename(home)
    assert running.client.get("/api/project").status_code == 200


def test_many_pages_save_at_once(folder, serve):
    running = serve(folder(1))
    running.client.put("/api/template", json={"names": ["a", "b", "c"]})
    answers = []

    def save(i):
        marks = {"points": [[i, i], [1, 1], [2, 9]], "invisible": [], "revision": None}
        answers.append(running.client.put("/api/pictures/p1.png/landmarks", json=marks))

    threads = [threading.Thread(target=save, args=(i,)) for i in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status_code for answer in answers) == [200] + [409] * 9
    (winner,) = (answer.json() for answer in answers if answer.status_code == 200)
    assert winner["revision"] == running.client.get("/api/pictures/p1.png/landmarks").json()["revision"]


# Events, and the end


def test_the_server_stops_although_pages_listen(folder_of_objects, serve, listen):
    running = serve(folder_of_objects(5, 4))
    pages = [listen(running) for _ in range(3)]
    running.client.post("/api/training", json={})
    process = running.studio.training._process
    running.stop()  # it fails if that takes as long as the event streams would stay open
    running.studio.close()
    assert not process.is_alive()
    for page in pages:
        assert page.line_with(b"no such line") == b""  # the stream has ended


def test_a_silent_stream_has_a_heartbeat(folder, serve, listen):
    page = listen(serve(folder(0), heartbeat_seconds=0.05))
    assert page.line_with(b": still here")


def test_a_page_that_goes_is_forgotten(folder, serve, listen):
    running = serve(folder(0), heartbeat_seconds=0.05)
    page, other = listen(running), listen(running)
    page.stream.close()
    page.connection.close()
    while len(running.studio.events) > 1:
        assert other.line_with(b": still here")
    assert len(running.studio.events) == 1


def test_a_page_that_falls_behind_is_let_go():
    import asyncio

    from liaam.studio.routes import ROOM, Events

    async def fall_behind():
        events = Events()
        stream = events.stream()
        assert (await anext(stream)).startswith("retry")
        for i in range(ROOM + 1):
            events.publish("training", {"i": i})
        await asyncio.sleep(0)  # lets the loop take what other threads may send
        assert [text async for text in stream] == []
        assert len(events) == 0

    asyncio.run(fall_behind())


@pytest.fixture
def command(folder):
    """Start ``liaam studio`` as a person does; gives the process, and its address."""
    started = []

    def start(*arguments):
        code = "from liaam.cli.main import main; main()"
        line = [sys.executable, "-c", code, "studio", *map(str, arguments), "--no-browser"]
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def test_ctrl_c_stops_the_command(folder, command):
    import signal

    process = command(folder(1), "--port", "0")
    address = process.stdout.readline().split()[-1]
    assert address.startswith("http://127.0.0.1:") and "/?token=" in address
    assert process.stdout.readline() == "Press Ctrl-C to stop it\n"
    with browser_of(follow_redirects=True) as browser:
        assert browser.get(address).status_code == 200
        with browser.stream("GET", address.partition("?")[0] + "api/events") as events:
            lines = events.iter_lines()
            assert next(lines).startswith("retry")
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
    assert process.stdout.read() == "stopped\n"


def test_what_was_saved_survives_a_kill(folder, command, serve):
    home = folder(2)
    process = command(home, "--port", "0", "--no-face")
    address = process.stdout.readline().split()[-1]
    with browser_of(follow_redirects=True) as browser:
        browser.get(address)
        site = address.partition("?")[0]
        browser.put(site + "api/template", json={"names": ["a", "b", "c"]}).raise_for_status()
        marks = {"points": [[1, 2], None, [3, 4]], "invisible": [], "revision": None}
        saved = browser.put(site + "api/pictures/p1.png/landmarks", json=marks).json()
        process.kill()
        process.wait()
    marks = serve(home).client.get("/api/pictures/p1.png/landmarks").json()
    assert marks["points"] == [[1, 2], None, [3, 4]] and marks["revision"] == saved["revision"]
    np.testing.assert_array_equal(read_landmarks(home / "p1.ljson").points[2], [3, 4])


@pytest.mark.slow
def test_a_training_ends_with_a_server_that_is_killed(folder, command):
    import psutil

    process = command(folder(8, 8), "--port", "0")
    address = process.stdout.readline().split()[-1]
    with browser_of(follow_redirects=True) as browser:
        browser.get(address)
        site = address.partition("?")[0]
        with browser.stream("GET", site + "api/events") as events:
            lines = events.iter_lines()
            browser.post(site + "api/training").raise_for_status()
            assert any('"state": "running"' in line for line in lines)
        children = psutil.Process(process.pid).children(recursive=True)
        assert children
        process.kill()
        process.wait()
    assert not psutil.wait_procs(children, timeout=60)[1]


@pytest.mark.slow
def test_a_second_studio_on_a_folder_is_told_where_the_first_is(folder, command):
    home = folder(1)
    first = command(home, "--port", "0")
    address = first.stdout.readline().split()[-1].partition("?")[0]
    second = command(home, "--port", "0")
    said = second.stdout.read()
    assert second.wait(60) == 1
    assert said.count("\n") == 1 and f"open in another studio ({address}, process {first.pid})" in said
    first.kill()
    first.wait()
    third = command(home, "--port", "0")
    assert third.stdout.readline().startswith("liaam studio: http://")


def test_ports_that_are_taken_are_passed_over(folder):
    with open_port("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(LiaamError, match=f"port {port} of 127.0.0.1 is not free .*--port"):
            open_port("127.0.0.1", port)
    with open_port("127.0.0.1", None) as first, open_port("127.0.0.1", None) as second:
        assert first.getsockname()[1] != second.getsockname()[1]
    with pytest.raises(LiaamError, match="ports are"):
        open_port("127.0.0.1", 70_000)
    with pytest.raises(LiaamError, match="choose another with --port"):
        open_port("203.0.113.7", None)


def test_the_command_refuses_what_is_no_folder(run, tmp_path):
    status, _, error = run("studio", tmp_path / "missing", "--no-browser")
    assert status == 1 and "does not exist" in error
    (tmp_path / "file.png").touch()
    status, _, error = run("studio", tmp_path / "file.png", "--no-browser")
    assert status == 1 and "is a file, not a folder" in error
    (tmp_path / "m.liaam").write_bytes(b"rubbish")
    status, _, error = run("studio", tmp_path, "--model", tmp_path / "m.liaam", "--no-browser")
    assert status == 1 and "m.liaam" in error


def test_a_missing_extra_is_one_line(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    status, _, error = run("studio", tmp_path, "--no-browser")
    assert status == 1
    assert (
        error.strip() == 'error: the studio needs starlette and uvicorn: pip install ".[studio]" in a checkout of liaam'
    )


def test_other_machines_are_let_in_with_a_warning_only(tmp_path, monkeypatch):
    from liaam.studio import serving

    opened, said = threading.Event(), []
    monkeypatch.setattr(serving.webbrowser, "open", lambda address: opened.set())
    settings = serving.StudioSettings(host="192.168.1.5", port=9000, token="T")
    serving._welcome(settings, True, said.append)
    assert said[0].startswith("warning: other machines can reach")
    assert said[1] == "liaam studio: http://192.168.1.5:9000/?token=T"
    assert opened.wait(60)
    assert serve_until_interrupted.__defaults__[1] == "127.0.0.1"


def test_files_written_by_hand_are_seen_at_once(folder, serve):
    home = folder(2)
    client = serve(home).client
    client.put("/api/template", json={"names": ["a", "b", "c"]})
    write_landmarks(home / "p2.pts", Landmarks([[1, 2], [3, 4], [5, 6]]))
    assert client.get("/api/pictures/p2.png/landmarks").json()["file"] == "p2.pts"
    write_image(home / "new.png", np.zeros((20, 20, 3), np.uint8))
    assert client.get("/api/pictures/new.png/image").status_code == 200
