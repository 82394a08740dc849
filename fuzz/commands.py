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
_LEFT_OUT = ("studio", "demo", "--scheduler", "--help")  # they serve, take long, or wait for a network
_SOUND = ("show", "--version", "fit --help", "camera invariant x.png -o out.png")
_FILED = ("--init", "--camera", "--image", "--lamps", "--light", "--patches", "--points")


def make(rng: Random) -> list[str]:
    """Return the arguments of a command."""
    if rng.random() < 0.2:
        return one_of(rng, _SOUND).split()
    command = one_of(rng, list(_commands()))
    arguments = command.split()
    arguments += [one_of(rng, _INPUTS) for _ in range(int(rng.integers(0, 4)))]
    for option, is_flag in _commands()[command].items():
        if rng.random() < (0.7 if option == "--output" else 0.2):
            arguments += [option] if is_flag else [option, _value(rng, option)]
    return [text.replace("\0", "") for text in arguments]


@cache
def _commands() -> dict[str, dict[str, bool]]:
    """Return the options of each command, and whether they are flags."""
    from typer.main import get_command

    from liaam.cli.main import app

    found: dict[str, dict[str, bool]] = {"nonsense": {}}
    below = [("", get_command(app))]
    for name, command in below:
        if inner := getattr(command, "commands", None):
            below += [(f"{name} {word}".strip(), each) for word, each in inner.items() if word not in _LEFT_OUT]
            continue
        options = [
            each for each in command.params if each.param_type_name == "option" and each.opts[0] not in _LEFT_OUT
        ]
        found[name] = {option.opts[0]: bool(getattr(option, "is_flag", False)) for option in options}
    return found


def _value(rng: Random, option: str) -> str:
    if option == "--output":
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
            "linear",
            "2:4",
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
