"""Files are either complete or not there."""

import errno
import io
import os
import re
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from liaam.errors import LiaamError, ModelFileError
from liaam.io import atomic, atomic_path, write_bytes_atomically, write_text_atomically
from setups import open_files

fcntl = pytest.importorskip("fcntl", reason="Windows neither locks nor sweeps temporary files")


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


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
    for _ in range(5):
        write_bytes_atomically(tmp_path / "a", b"x")
    assert open_files(tmp_path) == []


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


# Temporary files ------------------------------------------------------------------------------------

WRITER = """
import os, signal, sys
from liaam.io import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_bytes(b"half")
    print(temporary.name, flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def writer():
    """Start a process that writes a file, and is in the middle of it; gives it, and its temporary file."""
    started = []

    def start(path):
        line = [sys.executable, "-c", WRITER, path]
        process = subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        return process, path.with_name(process.stdout.readline().strip())

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_what_a_killed_writer_left_goes_with_the_next_write(tmp_path, writer):
    for name in ("a.csv", "b.csv"):
        process, temporary = writer(tmp_path / name)
        assert temporary.exists()
        process.kill()
        process.wait()
    process, alive = writer(tmp_path / "c.csv")
    assert names_in(tmp_path) == [alive.name]  # the first two are gone, as the third began
    write_bytes_atomically(tmp_path / "d.csv", b"whole")
    assert names_in(tmp_path) == [alive.name, "d.csv"]
    process.communicate("\n")
    assert names_in(tmp_path) == ["c.csv", "d.csv"]


def test_only_temporary_files_without_a_writer_are_swept(tmp_path):
    def left(name, age=0.0):
        (tmp_path / name).write_bytes(b"left")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
        return name

    ours, others = f".liaam-{atomic._HOST}0000000", ".liaam-00000000"
    gone = [left(f"{ours}1.csv"), left(f"{ours}2"), left(f"{ours}3.png", -1e9), left(f"{others}00000001.x", 90_000)]
    kept = [left(f"{others}00000002.csv"), left(".liaam-mine.csv"), left("liaam.csv"), left(f"{ours}4x")]
    (tmp_path / f"{ours}5.csv").mkdir()
    (tmp_path / f"{ours}6.csv").symlink_to("liaam.csv")
    os.mkfifo(tmp_path / f"{ours}7.csv")
    atomic.sweep(tmp_path)
    assert names_in(tmp_path) == sorted([*kept, f"{ours}5.csv", f"{ours}6.csv", f"{ours}7.csv"])
    assert not any((tmp_path / name).exists() for name in gone)
    with atomic_path(tmp_path / "x.csv") as temporary:
        atomic.sweep(tmp_path)
        assert temporary.exists()


def test_a_ctrl_c_as_a_temporary_file_is_made_leaves_none(tmp_path, monkeypatch):
    real = os.open

    def opened_and_stopped(path, *arguments, **options):
        descriptor = real(path, *arguments, **options)
        if ".liaam-" in str(path):
            os.close(descriptor)
            raise KeyboardInterrupt
        return descriptor

    monkeypatch.setattr(os, "open", opened_and_stopped)
    with pytest.raises(KeyboardInterrupt):
        write_bytes_atomically(tmp_path / "a.csv", b"whole")
    assert names_in(tmp_path) == []


def test_a_folder_is_swept_by_the_first_write_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    swept: list[Path] = []
    monkeypatch.setattr(atomic, "sweep", swept.append)
    for name in "ab":
        write_bytes_atomically(tmp_path / name, b"")
    assert swept == [tmp_path.resolve()]


def test_a_folder_that_cannot_be_listed_is_not_swept(tmp_path: Path) -> None:
    atomic.sweep(tmp_path / "missing")


def test_a_file_is_locked_once(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"")
    first, second = (os.open(tmp_path / "a", os.O_RDWR) for _ in range(2))
    assert atomic.lock(first) is True
    with pytest.raises(BlockingIOError):
        atomic.lock(second)
    os.close(first)
    assert atomic.lock(second, wait=True) is True
    os.close(second)


@pytest.mark.parametrize(("wait", "flags"), [(False, fcntl.LOCK_EX | fcntl.LOCK_NB), (True, fcntl.LOCK_EX)])
def test_disks_without_locks_are_recognised(monkeypatch: pytest.MonkeyPatch, wait: bool, flags: int) -> None:
    def flock(descriptor: int, how: int) -> None:
        assert (descriptor, how) == (7, flags)
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    assert atomic.lock(7, wait=wait) is False


def no_fcntl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "fcntl", None)


def no_opening_of_locked_files(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)


def no_writing_of_locked_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", lambda path, _: ReadOnly(path))


class ReadOnly(io.FileIO):
    def write(self, data: object) -> int:
        raise PermissionError(13, "Permission denied")


@pytest.mark.parametrize("without", [no_fcntl, no_opening_of_locked_files, no_writing_of_locked_files])
def test_without_usable_locks_temporary_files_are_kept_for_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without: Callable[[pytest.MonkeyPatch], None]
) -> None:
    with pytest.raises(RuntimeError), monkeypatch.context() as patched:
        without(patched)
        with atomic_path(tmp_path / "a.csv") as temporary:
            assert re.fullmatch(r"\.liaam-0{8}[0-9a-f]{16}\.csv", temporary.name)
            assert names_in(tmp_path) == [temporary.name]
            patched.undo()
            atomic.sweep(tmp_path)
            assert temporary.read_bytes() == b""
            raise RuntimeError
    assert names_in(tmp_path) == []
    assert open_files(tmp_path) == []


def test_a_locked_file_is_written_by_the_name_of_its_machine(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a") as temporary:
        assert re.fullmatch(rf"\.liaam-{atomic._HOST}[0-9a-f]{{16}}", temporary.name)
        assert len(atomic._HOST) == 8
        descriptor = os.open(temporary, os.O_RDWR)
        with pytest.raises(BlockingIOError):
            atomic.lock(descriptor)
        os.close(descriptor)


def test_a_temporary_file_that_is_swept_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, locked = atomic.lock, []

    def swept_first(descriptor: int, *, wait: bool = False) -> bool:
        locked.append(wait)
        if len(locked) == 1:
            next(tmp_path.iterdir()).unlink()
        return real(descriptor, wait=wait)

    monkeypatch.setattr(atomic, "lock", swept_first)
    write_bytes_atomically(tmp_path / "a", b"whole")
    assert open_files(tmp_path) == []
    assert (tmp_path / "a").read_bytes() == b"whole"
    assert locked == [True, True]


def test_a_file_of_the_same_name_is_not_taken_for_a_temporary_one(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"kept")
    with pytest.raises(FileExistsError):
        atomic._made(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"kept"


def test_without_locks_no_file_counts_as_locked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    no_fcntl(monkeypatch)
    assert atomic.lock(7) is False
    assert atomic._is_writable(tmp_path / "a") is False


def test_a_file_that_is_replaced_before_it_is_locked_is_not_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = tmp_path / f".liaam-{atomic._HOST}00000001"
    left.write_bytes(b"left")

    def replaced_first(descriptor: int) -> bool:
        (tmp_path / "new").write_bytes(b"new")
        (tmp_path / "new").replace(left)
        return True

    monkeypatch.setattr(atomic, "lock", replaced_first)
    atomic.sweep(tmp_path)
    assert left.read_bytes() == b"new"


def test_sweeping_leaves_no_file_open(tmp_path: Path) -> None:
    for i in range(5):
        (tmp_path / f".liaam-{atomic._HOST}0000000{i}").write_bytes(b"left")
    atomic.sweep(tmp_path)
    assert names_in(tmp_path) == []
    assert open_files(tmp_path) == []


@pytest.mark.parametrize(("number", "is_taken"), [(errno.EAGAIN, True), (errno.EACCES, True), (errno.ENOLCK, False)])
def test_a_lock_is_taken_or_not_supported(number, is_taken, monkeypatch, tmp_path):
    def refuse(descriptor, how):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with (tmp_path / "file").open("w") as file:
        if is_taken:
            with pytest.raises(BlockingIOError):
                atomic.lock(file.fileno())
        else:
            assert not atomic.lock(file.fileno())
