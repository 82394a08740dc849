"""Write the types of the studio's JSON for its page: ``python -m making.studio_types``, after a change of the contract.

The source is :mod:`liaam.studio.contract`. A test fails if the written file is not up to date.
"""

import types
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from liaam.studio.contract import EVENTS, TYPES

PATH = Path(__file__).parents[1] / "tests" / "studio" / "js" / "contract.d.ts"
HEAD = "// Types of the page's data, written by python -m making.studio_types from src/liaam/studio/contract.py.\n"
NAMES = {str: "string", int: "number", float: "number", bool: "boolean", type(None): "null", Any: "any"}


def typescript() -> str:
    """Return the types as TypeScript."""
    events = [f"  {name}: {name_of(hint)};" for name, hint in EVENTS.items()]
    of_events = ["/** Data of the events that the server sends, by kind. */", "interface Events {", *events, "}", ""]
    return "\n".join([HEAD, *map(_interface, TYPES), *of_events])


def _interface(kind: Any) -> str:
    """Return a typed dictionary as an interface."""
    lines = [f"/** {(kind.__doc__ or '').strip()} */", f"interface {kind.__name__} {{"]
    for name, hint in get_type_hints(kind, include_extras=True).items():
        comment, inner, is_optional = _opened(hint)
        if comment:
            lines.append(f"  /** {comment} */")
        lines.append(f"  {name}{'?' if is_optional else ''}: {name_of(inner)};")
    return "\n".join([*lines, "}", ""])


def _opened(hint: Any) -> tuple[str, Any, bool]:
    """Return the comment of a field, its type, and whether it may be missing."""
    comment = ""
    is_optional = False
    while get_origin(hint) in (Annotated, NotRequired):
        if get_origin(hint) is Annotated:
            comment = hint.__metadata__[0]
        else:
            is_optional = True
        hint = get_args(hint)[0]
    return comment, hint, is_optional


def name_of(hint: Any) -> str:
    """Return a type as TypeScript."""
    origin = get_origin(hint)
    inner = get_args(hint)
    if origin is Annotated:
        return name_of(inner[0])
    if is_typeddict(hint):
        return hint.__name__
    if origin in (Union, types.UnionType):
        return " | ".join(map(name_of, inner))
    if origin is Literal:
        return " | ".join("true" if value is True else f'"{value}"' for value in inner)
    if origin is list:
        element = name_of(inner[0])
        return f"({element})[]" if " " in element else f"{element}[]"
    if origin is tuple:
        return f"[{', '.join(map(name_of, inner))}]"
    if origin is dict:
        return f"Record<{name_of(inner[0])}, {name_of(inner[1])}>"
    return NAMES[hint]


if __name__ == "__main__":
    PATH.write_text(typescript(), encoding="utf-8")
