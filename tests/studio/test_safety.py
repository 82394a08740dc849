"""Bar of the studio: what comes from elsewhere, or is malformed, is refused; the server stays up; nothing leaks out."""

import json
import select
import socket
import struct
import time
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
from small_projects import browser_of

from liaam.io import Landmarks, write_image, write_landmarks

TEMPLATE = {"names": ["a", "b", "c"]}
MARKS = {"points": [[1, 2], [30, 2], [15, 20]], "invisible": [], "revision": None}


def snapshot(parent: Path) -> dict[str, bytes]:
    """All files below a folder, links not followed."""
    return {
        str(path.relative_to(parent)): b"link" if path.is_symlink() else path.read_bytes()
        for path in sorted(parent.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


@pytest.fixture
def home(tmp_path):
    """Give a project's folder in a parent with a secret beside it."""
    home = tmp_path / "parent" / "project"
    home.mkdir(parents=True)
    write_image(home / "p1.png", np.full((30, 40, 3), 90, np.uint8))
    (home.parent / "secret.txt").write_text("a secret")
    write_image(home.parent / "secret.png", np.zeros((9, 9, 3), np.uint8))
    write_landmarks(home.parent / "secret.ljson", Landmarks([[1, 2], [3, 4], [5, 6]]))
    return home


@pytest.fixture
def running(home, serve):
    return serve(home, json_bytes=20_000, upload_bytes=200_000, pixels=1_000_000, drain_seconds=60.0)


def is_up(running) -> bool:
    return running.client.get("/api/project").status_code == 200


def raw(running, data: bytes, patience: float = 30.0) -> bytes:
    """Send bytes as they are; gives what comes back until the server closes, or says nothing for a while."""
    with socket.create_connection(("127.0.0.1", running.port), 60) as connection:
        connection.settimeout(patience)
        parts = []
        try:
            connection.sendall(data)
            while part := connection.recv(65536):
                parts.append(part)
        except OSError:  # it closed, or waits for the rest of the request
            pass
    return b"".join(parts)


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


def request(running, target: str, method: str = "GET", *headers: str, body: bytes = b"") -> bytes:
    lines = [
        f"{method} {target} HTTP/1.1",
        f"Host: 127.0.0.1:{running.port}",
        f"Authorization: Bearer {running.studio.settings.token}",
        f"Content-Length: {len(body)}",
        "Connection: close",
        *headers,
    ]
    return "\r\n".join([*lines, "", ""]).encode() + body


# Who may ask


def test_the_address_gives_a_cookie_and_hides_the_token(running):
    with browser_of(running.url) as stranger:
        answer = stranger.get("/", params={"token": running.studio.settings.token})
        assert answer.status_code == 303 and answer.headers["location"] == "/"
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith(f"liaam-studio-{running.port}=")
        assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        assert stranger.get("/").status_code == 200  # with the cookie
        assert stranger.get("/api/project").status_code == 200


def test_without_the_token_nothing_is_given(running):
    with browser_of(running.url) as stranger:
        for path in ("/", "/?token=wrong", "/?token=", "/style.css", "/api/project", "/api/events", "/nowhere"):
            answer = stranger.get(path)
            assert answer.status_code == 401, path
            assert "token" in answer.json()["error"]
        for headers in (
            {"authorization": "Bearer wrong"},
            {"authorization": f"Basic {running.studio.settings.token}"},
            {"cookie": f"liaam-studio-{running.port}=wrong"},
            {"cookie": f"liaam-studio-1={running.studio.settings.token}"},
            {"authorization": "Bearer caf\u00e9".encode("latin-1")},
        ):
            assert stranger.get("/api/project", headers=headers).status_code == 401, headers


def test_the_token_in_the_address_serves_the_page_only(running):
    token = running.studio.settings.token
    for method, path in (("GET", "/api/project?"), ("POST", "/?"), ("GET", "/?token=x&")):
        with browser_of(running.url) as stranger:  # each without the cookie that another may have got
            assert stranger.request(method, f"{path}token={token}").status_code == 401


def test_a_browser_without_the_token_gets_a_page(running):
    with browser_of(running.url, headers={"accept": "text/html"}) as stranger:
        answer = stranger.get("/")
    assert answer.status_code == 401
    assert answer.headers["content-type"].startswith("text/html")
    assert "liaam studio" in answer.text


def test_own_names_are_taken_and_others_refused(running):
    port = running.port
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LocalHost:{port}", f"[::1]:{port}"):
        headers = {"host": host, "origin": f"http://{host}", "sec-fetch-site": "same-origin"}
        assert running.client.get("/api/project", headers=headers).status_code == 200, host
    for host in (
        "evil.example", f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", f"localhost.evil.example:{port}",
        f"127.0.0.1.evil.example:{port}", f"127.0.0.1:{port}.evil.example", "[::1]", "", f"127.0.0.1:{port}:{port}",
    ):  # fmt: skip
        assert running.client.get("/api/project", headers={"host": host}).status_code == 421, host


def test_two_hosts_are_refused(running):
    answer = raw(running, request(running, "/api/project", "GET", f"Host: localhost:{running.port}"))
    assert status_of(answer) in (400, 421)


def test_foreign_origins_and_requests_of_other_sites_are_refused(running):
    port = running.port
    for origin in (
        "http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1:1", "http://127.0.0.1",
        "file://", f"http://localhost:{port}.evil.example", f"http://127.0.0.1:{port}/",
    ):  # fmt: skip
        for method, path in (("GET", "/"), ("POST", "/api/training"), ("PUT", "/api/template")):
            assert running.client.request(method, path, headers={"origin": origin}).status_code == 403, origin
    token = {"token": running.studio.settings.token}
    for site in ("cross-site", "same-site", "nonsense"):
        for params in ({}, token):
            assert running.client.get("/", params=params, headers={"sec-fetch-site": site}).status_code == 403, site


def test_every_response_says_how_to_treat_it(running):
    token = running.studio.settings.token
    with browser_of(running.url) as stranger:
        refused = stranger.get("/")
    for answer in (
        running.client.get("/"),
        running.client.get("/api/project"),
        running.client.get("/api/nothing"),
        running.client.get("/", params={"token": token}),
        refused,
        running.client.get("/api/project", headers={"host": "evil.example"}),
        running.client.post("/api/uploads", content=b"x" * 300_000),
    ):
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["x-frame-options"] == "DENY"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert "server" not in answer.headers
    assert running.client.get("/api/project").headers["cache-control"] == "no-store"
    assert running.client.get("/api/pictures/p1.png/image").headers["cache-control"] == "private, no-cache"


# Where they may reach


OUTSIDE = (
    "..%2Fsecret.png", "../secret.png", "%2e%2e%2fsecret.png", "..%5Csecret.png", "%2e%2e/secret.png", "..", "%00",
    "p1.png%00", "....//secret.png", "%252e%252e%252fsecret.png", "/etc/passwd", "%2Fetc%2Fpasswd", "p1.png/",
    "..%c0%afsecret.png", "%ff%fe", "x" * 5000, ".liaam-studio", ".liaam-studio%2Fstudio.db",
)  # fmt: skip


def test_paths_do_not_leave_the_folder(running, home):
    running.client.put("/api/template", json=TEMPLATE)
    before = snapshot(home.parent)
    put, body = "Content-Type: application/json", json.dumps(MARKS).encode()
    for name in OUTSIDE:
        kinds = ("image", "chroma", "landmarks")
        targets = [*(f"/api/pictures/{name}/{what}" for what in kinds), f"/{name}", f"/static/{name}", f"/js/{name}"]
        answers = [raw(running, request(running, target)) for target in targets]
        answers.append(raw(running, request(running, f"/api/pictures/{name}/landmarks", "PUT", put, body=body)))
        for answer in answers:
            assert status_of(answer) in (400, 404, 405, 307), (name, answer[:200])
            assert b"a secret" not in answer and b"root:" not in answer
    assert snapshot(home.parent) == before
    assert is_up(running)


def test_links_that_lead_out_are_refused_both_ways(running, home):
    outside = home.parent
    (home / "link.png").symlink_to(outside / "secret.png")
    (home / "p1.ljson").symlink_to(outside / "secret.ljson")
    running.client.put("/api/template", json=TEMPLATE)
    before = snapshot(outside)
    assert running.client.get("/api/pictures/link.png/image").status_code == 404
    assert running.client.get("/api/pictures/p1.png/landmarks").json()["source"] == "none"
    answer = running.client.put("/api/pictures/p1.png/landmarks", json=MARKS)
    assert answer.status_code == 409 and "leads out of the folder" in answer.json()["error"]
    assert running.client.post("/api/fits", json={"picture": "link.png"}).status_code in (404, 409)
    assert snapshot(outside) == before


def test_a_state_folder_that_leads_out_is_refused_both_ways(home, serve):
    elsewhere = home.parent / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "template.json").write_text(json.dumps(TEMPLATE))
    (home / ".liaam-studio").symlink_to(elsewhere)
    before = snapshot(home.parent)
    running = serve(home)
    project = running.client.get("/api/project").json()
    assert project["template"] is None and any("remove it" in problem for problem in project["problems"])
    assert running.client.put("/api/template", json=TEMPLATE).status_code == 409
    assert snapshot(home.parent) == before


# How much they may send


def chunks(n: int, size: int = 10_000):
    for _ in range(n):
        yield b"x" * size


def test_large_json_is_refused(running):
    headers = {"content-type": "application/json"}
    for content in (b"[" + b"1," * 20_000 + b"1]", chunks(5)):  # with its length, and without
        answer = running.client.put("/api/template", content=content, headers=headers)
        assert answer.status_code == 413
        assert "20,000 bytes" in answer.json()["error"]
    assert is_up(running)


def test_large_uploads_are_refused(running):
    for content in (b"x" * 300_000, chunks(40)):
        answer = running.client.post("/api/uploads?name=x.png", content=content)
        assert answer.status_code == 413
    assert running.client.post("/api/template/file?name=x.pts", content=chunks(5)).status_code == 413
    assert is_up(running)


def test_a_length_that_is_a_lie_keeps_nobody_waiting(home, serve):
    running = serve(home, drain_seconds=0.2)
    lie = request(running, "/api/template", "PUT", "Content-Type: application/json")
    answer = raw(running, lie.replace(b"Content-Length: 0", b"Content-Length: 99999999999999999999999999") + b"{}")
    assert status_of(answer) in (400, 413)
    assert is_up(running)


def png(width: int, height: int, rows: bytes) -> bytes:
    def chunk(tag: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_decompression_bombs_are_refused_by_their_header(running):
    bomb = png(60_000, 60_000, zlib.compress(bytes(20_000_000), 9))
    assert len(bomb) < 100_000
    answer = running.client.post("/api/uploads?name=bomb.png", content=bomb)
    assert answer.status_code == 413 and "60000 x 60000 pixels" in answer.json()["error"]


def test_a_bomb_behind_a_small_header_is_refused(running):
    answer = running.client.post("/api/uploads?name=b.png", content=png(10, 10, zlib.compress(bytes(50_000_000), 9)))
    assert answer.status_code in (201, 422)  # a decoder reads the 310 bytes that the header promises, no more
    assert is_up(running)


def test_bad_json_is_refused(running):
    targets = (("PUT", "/api/template"), ("PUT", "/api/pictures/p1.png/landmarks"), ("POST", "/api/fits"))
    for body in (b"[" * 9000, b'{"a":' * 3000, b"{", b"", b"\xff\xfe", b"NaN", b"1" * 5000, b"[1e999]x"):
        for method, path in targets:
            answer = running.client.request(method, path, content=body, headers={"content-type": "application/json"})
            assert answer.status_code == 400, body[:9]
            assert answer.json()["error"]
    assert is_up(running)


def test_bodies_of_another_type_are_refused(running):
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        answer = running.client.put("/api/template", content=b"{}", headers={"content-type": kind})
        assert answer.status_code == 415


# Crowds, and requests that do not end


def picture(shade: int = 90) -> bytes:
    return png(40, 30, zlib.compress(bytes([0] + [shade] * 120) * 30))


def upload_line(running, length: int) -> bytes:
    return request(running, "/api/uploads?name=x.png", "POST").replace(
        b"Content-Length: 0", b"Content-Length: %d" % length
    )


def wait_until(condition, seconds: float = 60.0) -> None:
    due = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < due
        time.sleep(0.01)


def upload(running) -> httpx.Response:
    return running.client.post("/api/uploads?name=x.png", content=picture())


def test_more_uploads_than_there_is_room_for_are_asked_to_come_again(home, serve):
    running = serve(home, uploads_at_once=2, drain_seconds=0.2)
    held = [socket.create_connection(("127.0.0.1", running.port), 60) for _ in range(2)]
    for connection in held:
        connection.sendall(upload_line(running, 1000) + b"\x89PNG")
    wait_until(lambda: upload(running).status_code == 503)
    answer = upload(running)
    assert answer.status_code == 503 and int(answer.headers["retry-after"]) >= 1
    assert "try again" in answer.json()["error"]
    assert is_up(running)  # who brings no picture is not kept out
    for connection in held:
        connection.close()
    wait_until(lambda: upload(running).status_code == 201)


def test_bodies_under_way_hold_so_many_bytes_together(home, serve):
    running = serve(home, bodies_bytes=100_000, drain_seconds=0.2)
    with socket.create_connection(("127.0.0.1", running.port), 60) as connection:
        connection.sendall(upload_line(running, 99_999) + b"x" * 99_990)
        wait_until(lambda: upload(running).status_code == 503)
        assert is_up(running)
    wait_until(lambda: upload(running).status_code == 201)


def test_uploads_that_are_kept_hold_so_many_bytes_together(home, serve):
    running = serve(home, uploads_bytes=len(picture()) * 3)
    kept = [upload(running).json()["id"] for _ in range(5)]
    seen = [running.client.get(f"/api/uploads/{each}/image").status_code for each in kept]
    assert seen == [404, 404, 200, 200, 200]


def ends(running, data: bytes) -> bytes:
    """What comes back until the server hangs up, which it has to."""
    with socket.create_connection(("127.0.0.1", running.port), 60) as connection:
        connection.settimeout(60)
        connection.sendall(data)
        parts = []
        while part := connection.recv(65536):
            parts.append(part)
    return b"".join(parts)


@pytest.mark.parametrize("sent", [b"", b"G", b"GET / HTTP/1.1\r\nHost: x\r\n"])
def test_half_a_header_is_not_waited_for_for_ever(home, serve, sent):
    assert ends(serve(home, header_seconds=0.3), sent) == b""


def test_half_a_second_request_is_not_waited_for_for_ever(home, serve):
    running = serve(home, header_seconds=1.0)  # long enough for the first on a busy machine
    first = request(running, "/api/project").replace(b"Connection: close\r\n", b"")
    assert ends(running, first + b"GET / HT").count(b"HTTP/1.1 200") == 1


def test_drips_do_not_make_a_header_last(home, serve):
    running = serve(home, header_seconds=0.3)
    with socket.create_connection(("127.0.0.1", running.port), 60) as connection, pytest.raises(OSError):
        for _ in range(1200):  # for a minute
            connection.sendall(b"X")
            time.sleep(0.05)


@pytest.mark.parametrize("target", ["/api/uploads?name=x.png", "/api/fits"])
def test_half_a_body_is_not_waited_for_for_ever(home, serve, target):
    running = serve(home, body_seconds=0.3)
    lines = request(running, target, "POST", "Content-Type: application/json")
    answer = ends(running, lines.replace(b"Content-Length: 0", b"Content-Length: 50") + b'{"picture"')
    assert status_of(answer) == 408 and b"send it again" in answer


def test_a_body_that_nobody_reads_is_not_waited_for_for_ever(home, serve):
    running = serve(home, header_seconds=1.0)
    lines = request(running, "/api/project").replace(b"Connection: close\r\n", b"")
    assert status_of(ends(running, lines.replace(b"Content-Length: 0", b"Content-Length: 50") + b"x")) == 200


def half_sent(running) -> list[socket.socket]:
    """Connections that send the first lines of a request, or of an upload, or most of one; a third of them each."""
    half = (b"GET / HTTP/1.1\r\n", upload_line(running, 100_000) + b"x", upload_line(running, 70_000) + b"x" * 60_000)
    connections = [socket.create_connection(("127.0.0.1", running.port), 60) for _ in range(120)]
    for i, connection in enumerate(connections):
        connection.sendall(half[i % 3])
    return connections


def test_requests_that_stay_half_sent_keep_nobody_waiting(home, serve):
    running = serve(home, header_seconds=600.0, body_seconds=600.0, drain_seconds=0.2)
    connections = half_sent(running)
    assert is_up(running)
    assert not select.select(connections[::3], [], [], 0)[0]  # while they are still waited for
    for connection in connections:
        connection.close()
    wait_until(lambda: upload(running).status_code == 201)


def test_requests_that_stay_half_sent_are_hung_up_on(home, serve):
    running = serve(home, header_seconds=1.0, body_seconds=1.0, drain_seconds=0.2)
    for connection in half_sent(running):
        connection.settimeout(60)
        while connection.recv(65536):
            pass
        connection.close()
    assert upload(running).status_code == 201


def test_an_event_stream_lasts(home, serve):
    running = serve(home, header_seconds=0.5, body_seconds=0.5, heartbeat_seconds=0.1)
    with running.client.stream("GET", "/api/events") as stream:
        beats = (line for line in stream.iter_lines() if line.startswith(":"))
        for _ in range(10):  # for twice as long as a header or a body is waited for
            next(beats)


# Nonsense


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/fits", b'{"picture": "\\ud800"}'),
        ("POST", "/api/fits", b'{"upload": "\\udfff\\ud800"}'),
        ("POST", "/api/fits", b'{"picture": "p1.png", "method": "\\ud800"}'),
        ("PUT", "/api/template", b'{"names": ["\\ud800", "b", "c"]}'),
        ("PUT", "/api/pictures/p1.png/landmarks", b'{"\\ud800": 1}'),
        ("POST", "/api/training", b'{"id": "\\ud800"}'),
    ],
)
def test_half_a_surrogate_pair_is_refused(running, method, path, body):
    answer = running.client.request(method, path, content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 400 and "surrogates" in answer.json()["error"]


def test_a_whole_surrogate_pair_is_a_letter(running):
    answer = running.client.put(
        "/api/template",
        content=b'{"names": ["\\ud83d\\ude00", "b", "c"]}',
        headers={"content-type": "application/json"},
    )
    assert answer.status_code == 200 and answer.json()["names"][0] == "\U0001f600"


GOOD_TARGETS = (
    *("/", "/api/project", "/api/pictures/p1.png/landmarks", "/api/template", "/api/training", "/api/uploads"),
    *("/api/fits", "/api/template/file?name=x.pts", "/api/pictures/p1.png/image?size=9", "/style.css"),
)
BAD_TARGETS = (
    *("/api/fits/1/export?what=pts", "/api/model/file", "/api/pictures/%2e%2e/image", "/api/uploads/x/image", "/?a=%"),
    *("*", "//", "/\x00", "http://[", "/%", "/%zz", "/\xff", "/api/pictures/p1.png/image?size=1e9", "api/project", ""),
)
BAD_BODIES = (
    *(b"[]", b"null", b'"x"', b"{" * 200, b'{"names": [1]}', b'{"points": {}}', b'{"picture": [[[]]], "start": 7}'),
    json.dumps({"picture": "../secret.png", "method": "x" * 999}).encode(),
    json.dumps({"picture": "p1.png", "start": {"box": [1, "a"]}}).encode(),
    json.dumps({"names": ["a"], "mirror": [[0]], "mapping": {}, "contours": [None]}).encode(),
    json.dumps({"points": [[1, 2]] * 999, "invisible": [[]], "revision": {}}).encode(),
)
BAD_LINES = (
    *("Transfer-Encoding: chunked", "Transfer-Encoding: gzip, chunked", "Expect: 100-continue", "no colon here"),
    *(
        " folded",
        "X: " + "y" * 70_000,
        "Upgrade: websocket",
        "Range: bytes=9-1,-5,x",
        'If-None-Match: "',
        "Cookie: =;;=",
    ),
    *("Host: twice", "Origin: null", "Content-Length: 5", "Accept: \xff", "Sec-Fetch-Site: cross-site"),
)


def nonsense(rng: np.random.Generator, running) -> bytes:
    """One malformed request: the parts of a good one, some of them broken."""
    token = running.studio.settings.token

    def pick(good, bad):
        options = good if rng.random() < 0.75 else bad
        return options[rng.integers(len(options))]

    body = pick(BAD_BODIES, (b"", b"{}", rng.bytes(200), png(3, 3, b"rubbish"), b"\x89PNG\r\n\x1a\n"))
    method = pick(
        ("GET", "PUT", "POST", "DELETE"), ("PATCH", "OPTIONS", "TRACE", "CONNECT", "get", "G\x00T", "", "X" * 300)
    )
    version = pick(("HTTP/1.1",), ("HTTP/1.0", "HTTP/9.9", "HTTP/1.1 x", "", "\x7f"))
    lines = [
        f"{method} {pick(GOOD_TARGETS, BAD_TARGETS)} {version}",
        f"Host: {pick((f'127.0.0.1:{running.port}',), ('evil.example', ''))}",
        f"Authorization: Bearer {pick((token,), ('wrong', ''))}",
        f"Content-Type: {pick(('application/json',), ('application/json;' + 'x' * 2000, 'image/png', '', chr(1)))}",
        f"Content-Length: {pick((len(body),), (len(body) + 7, -1, 'x', '1e9', '', 0, 10**30))}",
    ]
    lines += [pick(("X: y",), BAD_LINES) for _ in range(rng.integers(3))]
    data = pick(("\r\n",), ("\n", "\r")).join([*lines, "", ""]).encode("latin-1") + body
    if rng.random() < 0.1:
        data = data[: rng.integers(len(data))]
    if rng.random() < 0.1:
        at = rng.integers(len(data) + 1)
        data = data[:at] + rng.bytes(9) + data[at:]
    return data


CLEAR = {200, 201, 303, 307, 400, 401, 403, 404, 405, 409, 413, 415, 416, 421, 422}
"""Statuses that malformed requests may get; some of them are good requests."""


@pytest.mark.slow
def test_malformed_requests_are_refused_and_the_server_stays_up(running, home, rng, caplog):
    running.client.put("/api/template", json=TEMPLATE)
    before = snapshot(home.parent)
    seen = Counter()
    requests = [nonsense(rng, running) for _ in range(200)]
    with ThreadPoolExecutor(8) as pool:  # many wait for an answer that does not come
        for answer in pool.map(lambda request: raw(running, request, 0.4), requests):
            seen[status_of(answer) if answer else None] += 1
    assert is_up(running)
    assert set(seen) <= CLEAR | {None}, seen  # None: it waits for the rest of the request
    assert {400, 401, 404, 405, 415, 421, 422} <= set(seen), seen  # they came to every door
    assert snapshot(home.parent) == before
    assert "Traceback" not in caplog.text
