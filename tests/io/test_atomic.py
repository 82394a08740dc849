"""Files are either complete or not there."""

import errno
import os
import stat
import subprocess
import sys
import time
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

    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    ours, others = f".liaam-{atomic._HOST}-{ended.pid}-", f".liaam-{'0' * 8}-1-"
    alive = f".liaam-{atomic._HOST}-{os.getpid()}-{'0' * 16}.csv"
    tags = [f"{i:016x}" for i in range(8)]
    gone = [left(f"{ours}{tags[1]}.csv"), left(f"{ours}{tags[2]}"), left(f"{ours}{tags[3]}.png", -1e9)]
    gone += [left(f"{others}{tags[1]}.x", 90_000)]
    kept = [left(f"{others}{tags[2]}.csv"), left(".liaam-mine.csv"), left("liaam.csv"), left(f"{ours}4x")]
    kept += [left(alive, 90_000)]
    (tmp_path / f"{ours}{tags[5]}.csv").mkdir()
    (tmp_path / f"{ours}{tags[6]}.csv").symlink_to("liaam.csv")
    os.mkfifo(tmp_path / f"{ours}{tags[7]}.csv")
    atomic.sweep(tmp_path)
    assert names_in(tmp_path) == sorted([*kept, *(f"{ours}{tag}.csv" for tag in tags[5:])])
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
    assert atomic.lock(second) is True
    os.close(second)


def test_disks_without_locks_are_recognised(monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(descriptor: int, how: int) -> None:
        assert (descriptor, how) == (7, fcntl.LOCK_EX | fcntl.LOCK_NB)
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    assert atomic.lock(7) is False


def test_a_process_of_another_user_is_alive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(process: int, signal: int) -> None:
        assert (process, signal) == (1, 0)
        raise PermissionError

    monkeypatch.setattr(os, "kill", refuse)
    (tmp_path / f".liaam-{atomic._HOST}-1-{'0' * 16}").write_bytes(b"half")
    atomic.sweep(tmp_path)
    assert len(names_in(tmp_path)) == 1


def test_where_processes_cannot_be_asked_for_temporary_files_are_kept_for_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic, "_SEES_PROCESSES", False)
    for name, age in (("old", 90_000), ("new", 0)):
        left = tmp_path / f".liaam-{atomic._HOST}-999999999-{'0' * 16}.{name}"
        left.write_bytes(b"half")
        os.utime(left, (time.time() - age,) * 2)
    atomic.sweep(tmp_path)
    assert [Path(name).suffix for name in names_in(tmp_path)] == [".new"]


def test_without_locks_no_file_counts_as_locked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "fcntl", None)
    assert atomic.lock(7) is False


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


def test_a_full_disk_is_told_from_other_faults(tmp_path: Path) -> None:
    for number, expected in ((errno.ENOSPC, True), (errno.EACCES, False)):
        with pytest.raises(LiaamError) as caught, atomic_path(tmp_path / "a"):
            raise OSError(number, os.strerror(number))
        assert atomic.is_disk_full(caught.value) is expected
    assert not atomic.is_disk_full(LiaamError("of another kind"))
