"""Files are either complete or not there."""

import os
import stat
from pathlib import Path

import pytest

from liaam.errors import LiaamError, ModelFileError
from liaam.io import atomic_path, write_bytes_atomically, write_text_atomically


def test_failure_in_the_middle_keeps_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="stop"), atomic_path(target) as temp:
        temp.write_text("half")
        raise RuntimeError("stop")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_disk_s_fault_has_the_wanted_class(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="No space left"), atomic_path(tmp_path / "a", ModelFileError):
        raise OSError(28, "No space left on device")
    with pytest.raises(LiaamError, match="is a folder"):
        write_bytes_atomically(tmp_path, b"")
    with pytest.raises(LiaamError, match="rename"):
        write_text_atomically(tmp_path / "a", "\udc80")
    assert list(tmp_path.iterdir()) == []


def test_atomic_writing_keeps_rights_links_and_suffix(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    target.chmod(0o640)
    (tmp_path / "link").symlink_to(target)
    with atomic_path(tmp_path / "link") as temp:
        assert temp.suffix == ".txt"
        assert temp.parent == tmp_path.resolve()
        temp.write_text("new")
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert (tmp_path / "link").is_symlink()


def test_new_files_have_the_usual_rights(tmp_path: Path) -> None:
    write_text_atomically(tmp_path / "a", "x\n")
    (tmp_path / "b").write_bytes(b"x\n")
    assert (tmp_path / "a").read_bytes() == b"x\n"
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_there_is_an_empty_file_to_write_to(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.png") as temp, atomic_path(tmp_path / "a.png") as other:
        assert temp.read_bytes() == b""
        assert temp.name.startswith(".liaam-") and temp.suffix == ".png"
        assert temp != other
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_what_is_written_is_on_the_disk_before_and_after_it_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    forced = []

    def fsync(descriptor: int) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        forced.append(("folder" if path.is_dir() else path.read_text(), target.read_text()))

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("this system does not say what a descriptor is of")
    monkeypatch.setattr(os, "fsync", fsync)
    write_text_atomically(target, "new")
    assert forced == [("new", "old"), ("folder", "new")]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = tmp_path / "no" / "a.txt"
    with pytest.raises(ModelFileError) as caught:
        write_bytes_atomically(path, b"x", ModelFileError)
    assert str(caught.value) == f"{path} cannot be written: the folder {path.parent} does not exist. Make it first."


def test_no_file_is_left_open(tmp_path: Path) -> None:
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("this system does not list descriptors")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        write_bytes_atomically(tmp_path / "a", b"x")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (
            OSError(28, "No space left on device"),
            r"a\.txt cannot be written \(No space left on device\): check the permissions",
        ),
        (OSError("odd"), r"a\.txt cannot be written \(odd\): check the permissions and the free space"),
    ],
)
def test_the_disk_s_fault_is_named(tmp_path: Path, fault: OSError, words: str) -> None:
    with pytest.raises(LiaamError, match=words) as caught, atomic_path(tmp_path / "a.txt"):
        raise fault
    assert caught.value.__cause__ is fault
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_forced_to_the_disk_is_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = os.fsync

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(22, "Invalid argument")
        whole(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    write_bytes_atomically(tmp_path / "a", b"x")
    assert (tmp_path / "a").read_bytes() == b"x"


def test_text_is_written_as_it_is(tmp_path: Path) -> None:
    write_text_atomically(tmp_path / "a", "ä\r\nb\n")
    assert (tmp_path / "a").read_bytes() == b"\xc3\xa4\r\nb\n"
