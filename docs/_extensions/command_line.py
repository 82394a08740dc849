"""The options of every command, taken from the command line itself: ``{{ commands }}`` in a Markdown page."""

from collections.abc import Iterator
from pathlib import PurePath
from typing import Any

from sphinx.application import Sphinx

PLACE = "{{ commands }}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Fill in the page as it is read."""
    app.connect("source-read", read, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def read(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace the placeholder by the commands."""
    if PLACE in source[0]:
        source[0] = source[0].replace(PLACE, "\n".join(all_commands()))


def all_commands() -> Iterator[str]:
    """Lines of Markdown on every command."""
    import typer

    from liaam.cli.main import app

    yield from sections("liaam", typer.main.get_command(app), 2)


def sections(name: str, group: Any, level: int) -> Iterator[str]:
    """Lines on the commands of a group."""
    for word, command in group.commands.items():
        yield from (f"{'#' * level} `{name} {word}`", "", (command.help or "").strip(), "")
        if hasattr(command, "commands"):
            yield from sections(f"{name} {word}", command, level + 1)
        else:
            yield from usage(f"{name} {word}", command)


def usage(name: str, command: Any) -> Iterator[str]:
    """Lines on the usage and the parameters of one command."""
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    words = [name, *(p.metavar or p.name.upper() for p in arguments), *(["[OPTIONS]"] if options else [])]
    yield from ("```text", " ".join(words), "```", "")
    if not command.params:
        return
    yield from ("| parameter | meaning |", "|---|---|")
    for parameter in arguments + options:
        yield f"| {spelling(parameter)} | {meaning(parameter)} |"
    yield ""


def spelling(parameter: Any) -> str:
    """How to write a parameter."""
    if parameter.param_type_name == "argument":
        return f"`{parameter.metavar or parameter.name.upper()}`"
    names = ", ".join(f"`{option}`" for option in [*parameter.opts, *parameter.secondary_opts])
    value = "" if parameter.is_flag else f" `{parameter.metavar or parameter.name.upper()}`"
    return names + value


def meaning(parameter: Any) -> str:
    """What a parameter does, and its default."""
    text = " ".join((parameter.help or "").replace("|", "\\|").split())
    default = parameter.default
    known = isinstance(default, str | int | float | PurePath) and not isinstance(default, bool)
    if parameter.required and parameter.param_type_name == "option":
        return f"{text} Required."
    return f"{text} Default: `{default}`." if known and str(default) not in ("", ".") else text
