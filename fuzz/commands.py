"""The command line with unusual names, paths and numbers."""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from unittest.mock import patch

from fuzz.mutate import NUMBERS, Random, one_of
from fuzz.target import Target

_INPUTS = (
    *(
        "x.png",
        "x.pts",
        "folder",
        "empty",
        "nothing.liaam",
        "face",
        "broken.liaam",
        "noise.png",
        "dangling.png",
        "loop.png",
        "fifo",
    ),
    *(
        "/dev/null",
        "/dev/zero",
        "/dev/full",
        "/proc/self/mem",
        "/proc/self/environ",
        ".",
        "/",
        "",
        "~",
        "-",
        "--",
        "-x",
    ),
    *(
        "a" * 255,
        "a" * 256 + ".png",
        "a/" * 3000,
        "x\x1b[31mred.png",
        "x\udcff.png",
        "ü.png",
        "a\nb.png",
        "[bold]x[/]",
        "[/x]",
    ),
    *(
        "folder/*.png",
        "**",
        "[",
        "*" * 100,
        "{0}",
        "%s",
        "camera.json",
        "list.txt",
        "deep.json",
        "x.box",
        "x.csv",
        "x.lamps",
    ),
    "x.mp4",
)
_OUTPUTS = (
    *(
        "out",
        "out.png",
        "out.csv",
        "out.jsonl",
        "out.parquet",
        "out.json",
        "out.liaam",
        "out.lamps",
        "x.png",
        "folder",
        "",
    ),
    *(
        "a" * 255,
        "a" * 300 + ".csv",
        "no/where.csv",
        "x.png/y.csv",
        "/dev/full",
        "/proc/nothing/x.csv",
        "\x1b[2J.csv",
        "\udcff.csv",
    ),
    *("[/x].csv", "dangling.png", "loop.png"),
)
_COMMANDS: dict[str, tuple[str, ...]] = {
    "fit": ("--init", "--camera", "--response", "--method", "--rotations", "--iterations", "--scheme", "--all", "-o"),
    "show": ("--image", "-o"),
    "compact": ("--methods", "-o"),
    "check": ("--images", "--recursive"),
    "evaluate": ("--folds", "--init", "--normalise", "--limit", "--method", "--rotations", "-o"),
    "batch": ("--init", "--camera", "--response", "--list", "--method", "--jobs", "-o"),
    "train": (
        "--camera",
        "--theta",
        "--response",
        "--variance",
        "--prior",
        "--lamps",
        "--training-lamp",
        "--copies",
        "--methods",
        "--shapes",
        "-o",
    ),
    "track": ("--init", "--camera", "--response", "-o"),
    "camera invariant": ("--camera", "--theta", "--response", "-o"),
    "measure": ("--scale", "--replicates", "--resample", "--slide", "-o"),
    "lamps": ("--training-lamp", "--recursive", "-o"),
    "camera register": ("--camera", "--response", "-o"),
    "relight": ("--init", "--camera", "--like", "-o"),
    "camera scene": ("--camera", "--response", "-o"),
    "camera response": ("--camera", "--patches", "-o"),
    "camera noise": ("--camera", "-o"),
    "nonsense": (),
}
_SOUND = ("show", "--version", "fit --help", "camera invariant x.png -o out.png")
_FLAGS = ("--all", "--recursive")
_FILED = ("--init", "--camera", "--list", "--image", "--lamps", "--like", "--patches")


def make(rng: Random) -> list[str]:
    """Return the arguments of a command."""
    if rng.random() < 0.2:
        return one_of(rng, _SOUND).split()
    command = one_of(rng, list(_COMMANDS))
    arguments = command.split()
    arguments += [one_of(rng, _INPUTS) for _ in range(int(rng.integers(0, 4)))]
    for option in _COMMANDS[command]:
        if rng.random() < (0.7 if option == "-o" else 0.3):
            arguments += [option] if option in _FLAGS else [option, _value(rng, option)]
    return [text.replace("\0", "") for text in arguments]


def _value(rng: Random, option: str) -> str:
    if option == "-o":
        return one_of(rng, _OUTPUTS)
    if option in _FILED and rng.random() < 0.7:
        return one_of(rng, _INPUTS)
    return one_of(
        rng,
        (
            *(number.decode("utf-8", "replace") for number in NUMBERS),
            "1,2,30,40",
            "soft-li",
            "grey",
            "all",
            "image",
            "bending",
            "a" * 300,
        ),
    )


@cache
def _scene() -> None:
    """Create the named files, once in each child."""
    import os

    from fuzz import landmarks, pictures

    picture = pictures.corpus(".png")[0]
    for folder in ("folder", "empty"):
        Path(folder).mkdir()
    for name in ("x.png", "folder/1.png", "folder/2.png"):
        Path(name).write_bytes(picture)
    for name in ("x.pts", "folder/1.pts", "folder/2.pts"):
        Path(name).write_bytes(landmarks.corpus(".pts")[0])
    Path("broken.liaam").write_bytes(b"\x10\0\0\0\0\0\0\0{}              ")
    Path("noise.png").write_bytes(bytes(range(256)) * 10)
    Path("x.box").write_bytes(b"1,2,3,4")
    Path("x.csv").write_bytes(b"x,y\n1,2\n")
    Path("camera.json").write_bytes(b'{"format": "liaam-camera", "version": 1, "theta_deg": 122}')
    Path("deep.json").write_bytes(b"[" * 100_000)
    Path("list.txt").write_bytes(b"x.png\n" + b"a" * 5000 + b"\n\xff\n")
    Path("dangling.png").symlink_to("nowhere")
    Path("loop.png").symlink_to("loop.png")
    os.mkfifo("fifo")


def check(arguments: list[str]) -> None:
    """Run ``liaam``. It must exit with a status and a message, without escape sequences."""
    from liaam.cli.main import main
    from liaam.errors import LiaamError

    _scene()
    out, err = _stream(), _stream()
    with patch.object(sys, "argv", ["liaam", *arguments]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            status = 0
        except SystemExit as end:
            status = end.code
    said = _text(out) + _text(err)
    assert status in (0, 1, 2, None), f"status {status}"
    assert "Traceback" not in said
    assert "\x1b" not in said, "an escape sequence reaches the terminal"
    if status:
        assert said.strip(), "it fails without a word"
        raise LiaamError(said)


def _stream() -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="replace", write_through=True)


def _text(stream: io.TextIOWrapper) -> str:
    assert isinstance(stream.buffer, io.BytesIO)
    return stream.buffer.getvalue().decode("utf-8", "replace")


def _prepare() -> None:
    from liaam.errors import LiaamError

    for arguments in (
        ["show"],
        ["check", "folder"],
        ["camera", "invariant", "x.png", "-o", "warm.png"],
        ["show", "x.png"],
    ):
        try:
            check(arguments)
        except LiaamError:
            continue


TARGETS = (Target("commands", make, check, _prepare, ".txt", share=0.1),)
