"""Whether JSON, and answers to requests, keep the contract of the studio's server and page."""

import json
import re
from dataclasses import is_dataclass
from types import UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

import httpx

from liaam.studio import contract
from making.studio_types import optional_fields


def faults(value: Any, kind: Any, where: str = "") -> list[str]:
    """Where a value of JSON differs from a type."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return []
    if origin in (Annotated, NotRequired):
        return faults(value, inner[0], where)
    if origin in (Union, UnionType):
        found = [faults(value, each, where) for each in inner if each is not contract.Omitted]
        return [] if [] in found else min(found, key=len)
    if origin is Literal:
        return [] if value in inner else [f"{where}: {value!r}"]
    if is_typeddict(kind) or is_dataclass(kind):
        return faults_of_object(value, kind, where)
    if origin is list:
        if not isinstance(value, list):
            return [f"{where}: {value!r}"]
        return [fault for i, each in enumerate(value) for fault in faults(each, inner[0], f"{where}[{i}]")]
    if origin is tuple:
        if len(value) != len(inner):
            return [f"{where}: {value!r}"]
        return [fault for each, one in zip(value, inner, strict=True) for fault in faults(each, one, where)]
    if origin is dict:
        return [fault for name, each in value.items() for fault in faults(each, inner[1], f"{where}.{name}")]
    kinds = (int, float) if kind is float else kind
    is_number = kind in (int, float) and isinstance(value, bool)
    return [] if isinstance(value, kinds) and not is_number else [f"{where}: {value!r}"]


def faults_of_object(value: Any, kind: Any, where: str) -> list[str]:
    if not isinstance(value, dict):
        return [f"{where}: {value!r}"]
    hints = get_type_hints(kind, include_extras=True)
    found = [f"{where} lacks {name}" for name in hints.keys() - optional_fields(kind) - value.keys()]
    found += [f"{where}.{name} is not in the contract" for name in value.keys() - hints.keys()]
    return found + [
        fault for name in value.keys() & hints.keys() for fault in faults(value[name], hints[name], f"{where}.{name}")
    ]


def sent(value: Any) -> Any:
    """A value as the page gets it."""
    return json.loads(json.dumps(value, allow_nan=False))


def pattern_of(address: str) -> re.Pattern[str]:
    """What matches the addresses of a route, in any set of landmarks."""
    parts = [re.escape(part) for part in re.split(r"{\w+}", address)]
    return re.compile(r"(?:/set/[^/]+)?/api/" + "(.+)".join(parts))


PATTERNS = [(route.split()[0], pattern_of(route.split()[1]), endpoint) for route, endpoint in contract.ROUTES.items()]


def check_answer(answer: httpx.Response) -> None:
    """Fail if an answer with JSON, or a request with JSON that was accepted, is not as the contract says."""
    method, path = answer.request.method, answer.request.url.path
    is_json = answer.headers.get("content-type", "").startswith("application/json")
    if not is_json or "/api/" not in path or method == "HEAD":
        return
    answer.read()
    if answer.is_error:
        assert faults(answer.json(), contract.Fault) == []
        return
    (endpoint,) = [each for verb, pattern, each in PATTERNS if verb == method and pattern.fullmatch(path)]
    if endpoint.answer is bytes:  # a file that holds JSON
        return
    assert faults(answer.json(), endpoint.answer) == [], f"answer to {method} {path}"
    if is_dataclass(endpoint.body) and answer.request.content:
        asked = json.loads(answer.request.content)
        known = {name: value for name, value in asked.items() if name in get_type_hints(endpoint.body)}
        assert faults(known, endpoint.body) == [], f"{method} {path}"  # more is ignored
