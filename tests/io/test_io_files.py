"""Finding files, and saying why one cannot be found."""

import errno
import os
from pathlib import Path

import pytest

from liaam import load_camera, load_model, read_image, read_landmarks
from liaam.errors import ImageError, LandmarkError, LiaamError
from liaam.io.atomic import check_output
from liaam.io.files import (
    existing_file,
    is_number,
    json_object,
    make_folder,
    natural_key,
    read_bytes,
    real_path,
    some_names,
    writable,
)
from liaam.training import load_lamps


def complaint(path: Path, kind: str = "image") -> str:
    with pytest.raises(ImageError) as caught:
        existing_file(path, ImageError, kind)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_natural_order() -> None:
    assert sorted(["b1", "a10", "A2", "a²", "7"], key=natural_key) == ["7", "A2", "a10", "a²", "b1"]
    assert sorted(["x010", "x9", "x10", "x0009y"], key=natural_key) == ["x9", "x0009y", "x010", "x10"]
    assert sorted(["a1b10c2d", "a1b9c20d", "a1b9c3d"], key=natural_key) == ["a1b9c3d", "a1b9c20d", "a1b10c2d"]
    long = "1" + "0" * 9000  # longer than int() takes
    assert sorted([f"{long}1", long, "9"], key=natural_key) == ["9", long, f"{long}1"]


@pytest.mark.parametrize(
    ("text", "number"), [("1", True), ("-2.5e3", True), ("nan", False), ("inf", False), ("", False)]
)
def test_cells_that_are_numbers(text: str, number: bool) -> None:
    assert is_number(text) is number


def test_halves_of_surrogate_pairs_cannot_be_written() -> None:
    assert writable("aä\U0001f600") == "aä\U0001f600"
    assert writable("a\ud800b") == "a?b"


def test_a_file_that_is_there_is_given_as_a_path(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"x")
    assert existing_file(str(tmp_path / "a.png"), ImageError, "image") == tmp_path / "a.png"


def test_what_is_no_file_says_what_it_is(tmp_path: Path) -> None:
    assert complaint(tmp_path, "RAW file") == f"{tmp_path} is a folder; give the name of one RAW file inside it."
    (tmp_path / "a.png").touch()
    assert complaint(tmp_path / "a.png") == f"{tmp_path / 'a.png'} is empty (0 bytes): copy or export it again."
    assert complaint(Path("/dev/null")) == "/dev/null is not a regular file: give a file on disk."


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], "Nothing in {folder} has a similar name: check the path."),
        (["other.txt"], "Nothing in {folder} has a similar name: check the path."),
        (["face_01.png"], "Did you mean face_01.png?"),
        (["fuse_10.jpg"], "Did you mean fuse_10.jpg?"),
        (["face_01.png", "face_02.png"], "Did you mean face_02.png or face_01.png?"),
        ([f"face_0{i}.png" for i in range(1, 6)], "Did you mean face_05.png or face_04.png or face_03.png?"),
    ],
)
def test_a_missing_file_names_at_most_three_like_it(tmp_path: Path, names: list[str], words: str) -> None:
    for name in names:
        (tmp_path / name).touch()
    path = tmp_path / "face_0.png"
    assert complaint(path) == f"{path} does not exist. {words.format(folder=tmp_path)}"


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = tmp_path / "no" / "a.png"
    assert complaint(path) == f"{path} does not exist. The folder {path.parent} does not exist either: check the path."


@pytest.mark.parametrize(
    ("fault", "reason"), [(PermissionError(13, "Permission denied"), "Permission denied"), (OSError("odd"), "odd")]
)
def test_a_file_or_folder_that_may_not_be_read_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: OSError, reason: str
) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr(os, "scandir", forbidden)
    assert complaint(tmp_path) == f"{tmp_path} cannot be read ({reason}): check the name and permissions."
    (tmp_path / "a.pts").write_bytes(b"x")
    monkeypatch.setattr(Path, "read_bytes", forbidden)
    with pytest.raises(LandmarkError) as caught:
        read_bytes(tmp_path / "a.pts", LandmarkError, 1)
    assert str(caught.value) == f"{tmp_path / 'a.pts'} cannot be read ({reason}): check its permissions."


def test_files_are_read_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.pts"
    path.write_bytes(b"x" * 2000)
    assert read_bytes(path, LandmarkError, 2000) == b"x" * 2000
    with pytest.raises(LandmarkError) as caught:
        read_bytes(path, LandmarkError, 1999)
    assert str(caught.value) == f"{path} has 2,000 bytes, more than the 1,999 allowed: split it into smaller files."


def test_folders_for_results_are_made(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "c").touch()
    with pytest.raises(LiaamError) as caught:
        make_folder(tmp_path / "c")
    assert (
        str(caught.value) == f"{tmp_path / 'c'} is a file, so the folder cannot be created; give another folder with -o"
    )
    with pytest.raises(LiaamError) as caught:
        make_folder(tmp_path / "c" / "d")
    reason = os.strerror(errno.ENOTDIR)
    assert str(caught.value) == (
        f"{tmp_path / 'c' / 'd'}: the folder cannot be created ({reason}); give another folder with -o"
    )


def test_a_folder_that_cannot_be_made_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("odd")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(LiaamError, match=r"the folder cannot be created \(odd\)"):
        make_folder(tmp_path / "a")


def test_some_names() -> None:
    assert some_names(["a"]) == "a"
    assert some_names(list("abcdef")) == "a, b, c, d, e, f"
    assert some_names(list("abcdefgh")) == "a, b, c, d, e, f and 2 more"
    assert some_names(list("abcd"), most=2, joint="; ") == "a; b and 2 more"
    assert some_names(list("abc"), most=2) == "a, b, c"  # the number of one name is as long as the name


def test_a_read_only_folder_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_output(tmp_path / "m.liaam")
    monkeypatch.setattr(os, "access", lambda folder, mode: Path(folder) != tmp_path or not mode & os.W_OK)
    with pytest.raises(LiaamError, match=r"m\.liaam cannot be written: the folder .* is read-only\. Change its perm"):
        check_output(tmp_path / "m.liaam")
    with pytest.raises(LiaamError, match="the folder is read-only; change its permissions, or give another folder"):
        make_folder(tmp_path)


def test_links_are_resolved(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "there")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    assert real_path(tmp_path / "link") == tmp_path.resolve() / "there"
    assert real_path(str(tmp_path / "circle")).name == "circle"


@pytest.mark.parametrize(
    ("text", "parsed"),
    [
        ('{"a": 1}', {"a": 1}),
        (b"{}", {}),
        ("[1]", None),
        ("7", None),
        ("{", None),
        (b"\xff", None),
        ("[" * 100_000, None),
        (None, None),
    ],
)
def test_json_objects(text: str | bytes, parsed: dict | None) -> None:
    assert json_object(text) == parsed


# Files that are too large

SPARSE = {
    "a.jpg": b"\xff\xd8\xff",  # whose reader looks for the next marker in all of it
    "a.gif": b"GIF89a",
    "a.jp2": b"\0\0\0\x0cjP  \r\n\x87\n",
    "a.avif": b"\0\0\0\x20ftypavif",
    "a.pts": b"version: 1",
    "a.json": b"{",
    "a.liaam": b"\x10\0\0\0\0\0\0\0",
    "a.lamps": b"\x10\0\0\0\0\0\0\0",
}
READERS = {".pts": read_landmarks, ".json": load_camera, ".liaam": load_model, ".lamps": load_lamps}


@pytest.mark.parametrize("name", SPARSE)
def test_a_file_of_many_gigabytes_is_refused_by_its_size(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(SPARSE[name])
    os.truncate(path, 40 * 10**9)  # takes no room on the disk
    with pytest.raises(LiaamError, match=r"40,000,000,000 bytes, more than the [0-9,]+ allowed") as caught:
        READERS.get(path.suffix, read_image)(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("suffix", [".pts", ".json", ".liaam", ".lamps", ".png"])
def test_a_file_for_which_there_is_too_little_memory_is_named(suffix, tmp_path, monkeypatch):
    import safetensors

    def exhausted(*_, **__):
        raise MemoryError

    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"\0" * 100 if suffix == ".png" else b"\x02" + b"\0" * 7 + b"{}")
    monkeypatch.setattr(Path, "read_bytes", exhausted)
    monkeypatch.setattr(safetensors, "safe_open", exhausted)
    monkeypatch.setattr("liaam.io.images._open", exhausted)
    with pytest.raises(LiaamError, match=r"is too large for the free memory: make it smaller") as caught:
        READERS.get(suffix, read_image)(path)
    assert str(path) in str(caught.value)
