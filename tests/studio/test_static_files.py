"""The files of the page: kept by the browser as long as they do not change."""

import re
import shutil

import pytest

from liaam.studio.settings import STATIC
from liaam.studio.static_files import Page


@pytest.fixture
def page(tmp_path):
    """Give a page whose files can be changed."""
    shutil.copytree(STATIC, tmp_path / "static")
    return Page(tmp_path / "static")


def references(text):
    return re.findall(r'(?:href|src)="([^"#]+)"', text)


def test_all_files_of_the_page_are_referred_to_by_their_hash_and_all_modules_at_its_beginning(page):
    text = page.html()
    assert {name.split("/")[2] for name in references(text)} == {page.version}
    modules = {path.relative_to(page.folder).as_posix() for path in page.folder.rglob("*.js")}
    names = {name.split("/", 3)[3] for name in references(text)}
    assert modules <= names
    assert all((page.folder / name).is_file() for name in names)
    assert text.index("modulepreload") < text.index("</head>")
    assert 'modulepreload" href="/kept/' + page.version + '/js/theme.js"' not in text  # it is no module


def test_the_hash_changes_with_a_file_and_with_nothing_else(page):
    before = page.version
    assert Page(page.folder).version == before
    (page.folder / "js" / "main.js").write_text("// another")
    assert page.version != before


def test_a_reload_fetches_nothing_that_has_not_changed(folder, serve):
    client = serve(folder(1)).client
    first = client.get("/")
    assert first.headers["cache-control"] == "private, no-cache" and "etag" in first.headers
    again = client.get("/", headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    for name in references(first.text):
        answer = client.get(name)
        assert answer.status_code == 200, name
        assert answer.headers["cache-control"] == "private, max-age=31536000, immutable", name
        assert "default-src 'self'" in answer.headers["content-security-policy"]
    old = client.get("/kept/0123456789abcdef/js/main.js")
    assert old.status_code == 200 and old.headers["cache-control"] == "no-store"
    assert client.get("/kept/x/../../app.py").status_code == 404
    assert client.get("/style.css").headers["cache-control"] == "no-store"
    assert f"/kept/{references(first.text)[0].split('/')[2]}/" in first.text


def test_pictures_are_kept_at_addresses_that_name_their_content(folder, serve):
    client = serve(folder(1)).client
    tag = client.get("/api/project").json()["pictures"][0]["tag"]
    address = "/api/pictures/p1.png/image"
    assert "immutable" in client.get(address, params={"tag": tag, "size": 160}).headers["cache-control"]
    for params in ({}, {"tag": "another"}):
        assert client.get(address, params=params).headers["cache-control"] == "private, no-cache"


def test_the_page_of_a_set_shares_the_files(folder, serve):
    client = serve(folder(1, 1)).client
    client.post("/api/sets", json={"name": "anna", "same": True})
    assert references(client.get("/set/anna/").text) == references(client.get("/").text)
