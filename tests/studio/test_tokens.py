"""The token of a folder, which lasts from one start to the next, and which nobody else can read."""

import os
import stat

import pytest

from liaam.studio.tokens import TICKET_SECONDS, TOKEN_SECONDS, Tickets, lasting_token


@pytest.fixture
def state(tmp_path, monkeypatch):
    """Give the user's state folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def files(state):
    return [path for path in state.rglob("*") if path.is_file()]


def test_a_folder_has_the_same_token_at_each_start_and_another_one_than_others(state, tmp_path):
    first = lasting_token(tmp_path)
    assert len(first) >= 32
    assert lasting_token(tmp_path) == first
    (tmp_path / "link").symlink_to(tmp_path)
    assert lasting_token(tmp_path / "link") == first
    assert lasting_token(tmp_path.parent) != first
    assert len(files(state)) == 2


def test_only_the_user_can_read_it(state, tmp_path):
    lasting_token(tmp_path)
    (file,) = files(state)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700


@pytest.mark.parametrize("what", ["readable", "link", "folder", "short", "binary", "empty", "pipe"])
def test_a_token_that_others_may_know_is_replaced(state, tmp_path, what):
    first = lasting_token(tmp_path)
    (file,) = files(state)
    if what == "readable":
        file.chmod(0o644)
    elif what == "link":
        file.rename(tmp_path / "other")
        file.symlink_to(tmp_path / "other")
    else:
        file.unlink()
        if what == "folder":
            file.mkdir()
        elif what == "pipe":
            os.mkfifo(file, 0o600)
        else:
            file.write_bytes({"short": b"abc", "binary": b"\xff" * 40, "empty": b""}[what])
            file.chmod(0o600)
    second = lasting_token(tmp_path)
    assert second != first and len(second) >= 32
    if what != "folder":  # nothing can be written there, so the token is for this time
        assert lasting_token(tmp_path) == second


def test_a_start_after_thirty_days_has_another_token(state, tmp_path):
    first = lasting_token(tmp_path)
    (file,) = files(state)
    made = file.stat().st_mtime
    os.utime(file, (made, made - TOKEN_SECONDS + 60))
    assert lasting_token(tmp_path) == first
    os.utime(file, (made, made - TOKEN_SECONDS - 60))
    second = lasting_token(tmp_path)
    assert second != first and lasting_token(tmp_path) == second


def test_without_a_state_folder_each_start_has_another_token(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    assert lasting_token(tmp_path) != lasting_token(tmp_path)


def test_a_ticket_is_valid_once_and_for_a_while():
    now = [0.0]
    tickets = Tickets(lambda: now[0])
    first, second = tickets.new(), tickets.new()
    assert len(first) >= 32 and first != second
    assert [tickets.take(text) for text in (first, first, "x", "")] == [True, False, False, False]
    now[0] = TICKET_SECONDS + 1
    assert not tickets.take(second)
