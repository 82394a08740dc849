"""Write the types of the studio's JSON for its page: ``python -m making.studio_types``, after a change of the contract.

The source is :mod:`liaam.studio.contract`. A test fails if the written file is not up to date.
"""

import re
import types
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from liaam.studio import contract
from liaam.studio.contract import EVENTS, ROUTES, Endpoint, Omitted, Query, Request

PATH = Path(__file__).parents[1] / "tests" / "studio" / "js" / "contract.d.ts"
HEAD = "// Types of the page's data, written by python -m making.studio_types from src/liaam/studio/contract.py.\n"
NAMES = {str: "string", int: "number", float: "number", bool: "boolean", type(None): "null", Any: "any"}
IN_ADDRESS = "string | number"
"""Type of what an address holds: the page gives numbers as they are."""

NOT_SENT = (Endpoint, Query, Request)


def typescript() -> str:
    """Return the types as TypeScript."""
    events = [f"  {name}: {name_of(hint)};" for name, hint in EVENTS.items()]
    of_events = ["/** Data of the events that the server sends, by kind. */", "interface Events {", *events, "}", ""]
    return "\n".join([HEAD, *map(_interface, sent_types()), *of_events, *_routes()])


def sent_types() -> list[Any]:
    """Return all types of the contract, in the order in which they are written there."""
    known = [each for each in vars(contract).values() if is_typeddict(each) or is_dataclass(each)]
    return [each for each in known if each not in NOT_SENT]


def optional_fields(kind: Any) -> set[str]:
    """Return the names of the fields that may be left out."""
    if is_dataclass(kind):
        return {field.name for field in fields(kind) if field.default is not MISSING}
    return set(kind.__optional_keys__)


def _interface(kind: Any) -> str:
    """Return a typed dictionary or a dataclass as an interface."""
    lines = [f"/** {(kind.__doc__ or '').strip()} */", f"interface {kind.__name__} {{"]
    optional = optional_fields(kind)
    for name, hint in get_type_hints(kind, include_extras=True).items():
        comment, inner = _opened(hint)
        if comment:
            lines.append(f"  /** {comment} */")
        what = IN_ADDRESS if issubclass(kind, Query) else name_of(inner)
        lines.append(f"  {name}{'?' if name in optional else ''}: {what};")
    return "\n".join([*lines, "}", ""])


def _opened(hint: Any) -> tuple[str, Any]:
    """Return the comment of a field, and its type."""
    comment = ""
    while get_origin(hint) in (Annotated, NotRequired):
        if get_origin(hint) is Annotated:
            comment = hint.__metadata__[0]
        hint = get_args(hint)[0]
    return comment, hint


def _routes() -> Iterator[str]:
    """Yield the lines of an interface with all routes."""
    by_address: dict[str, dict[str, Endpoint]] = {}
    for route, endpoint in ROUTES.items():
        method, address = route.split()
        by_address.setdefault(address, {})[method] = endpoint
    yield "/** All routes by their addresses: what varies in these, and what each method takes and answers. */"
    yield "interface Routes {"
    for address, methods in by_address.items():
        yield f'  "{address}": {{'
        yield f"    fields: {_fields_of(address, methods)};"
        for method, endpoint in methods.items():
            yield f"    {method}: {{ {_exchange(endpoint)} }};"
        yield "  };"
    yield "}"
    yield ""


def _fields_of(address: str, methods: dict[str, Endpoint]) -> str:
    """Return the type of what an address holds: the names in it, and the queries of its methods."""
    parts = [f"{name}: {IN_ADDRESS}" for name in re.findall(r"{(\w+)}", address)]
    queries = [each.query.__name__ for each in methods.values() if each.query is not None]
    return " & ".join([*([f"{{ {'; '.join(parts)} }}"] if parts else []), *queries]) or "{}"


def _exchange(endpoint: Endpoint) -> str:
    """Return what a method takes and answers, a file as ``file``."""
    body = "" if endpoint.body is None else f"body: {_sent(endpoint.body)}; "
    return f"{body}{'file' if endpoint.answer is bytes else 'answer'}: {_sent(endpoint.answer)}"


def _sent(hint: Any) -> str:
    if hint is bytes:
        return "Blob"
    return "null" if hint is None else name_of(hint)


def name_of(hint: Any) -> str:
    """Return a type as TypeScript."""
    origin = get_origin(hint)
    inner = get_args(hint)
    if origin is Annotated:
        return name_of(inner[0])
    if is_typeddict(hint) or (isinstance(hint, type) and is_dataclass(hint)):
        return hint.__name__
    if origin in (Union, types.UnionType):
        return " | ".join(name_of(each) for each in inner if each is not Omitted)
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
