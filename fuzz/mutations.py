"""Mutations: small changes to a module's source, one at a time, that its tests have to notice.

Left alone: docstrings, the wording of messages (text with a blank, in a ``raise`` or in an f-string), annotations,
imports, decorators, ``__all__``, and swaps that raise a TypeError at once.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

_COMPARISONS: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
_ARITHMETIC: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult,
}  # fmt: skip
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_UNORDERED = {"min", "max", "np.minimum", "np.maximum", "isinstance", "getattr", "hasattr", "zip"}
_SKIPPED = {"annotation", "returns", "decorator_list", "cause", "format_spec", "ctx", "op", "ops"}


@dataclass(frozen=True, eq=False)
class Mutant:
    """One change to a syntax tree."""

    line: int
    lines: range
    """Lines of the statement: the tests that run one of them are tried."""
    function: str
    """Qualified name of the outermost function; empty for what is run when the module is imported."""
    change: str
    apply: Callable[[], None]
    """Changes the tree, once and for all."""


def mutants_of(tree: ast.Module) -> list[Mutant]:
    """List all mutants of a module's tree."""
    return list(_walk(tree, (), "", range(0), False))


def _walk(node: ast.AST, scope: tuple[str, ...], function: str, lines: range, wording: bool) -> Iterator[Mutant]:
    wording = wording or isinstance(node, ast.Raise | ast.JoinedStr)
    is_function = isinstance(node, _FUNCTIONS)
    for name, value in ast.iter_fields(node):
        # Defaults of arguments are made when the function is.
        where = "" if is_function and name == "args" and ".".join(scope) == function else function
        items = value if isinstance(value, list) else [value]
        for i, child in enumerate(items):
            if not isinstance(child, ast.AST) or name in _SKIPPED or _is_left_alone(child, where):
                continue
            at = _header(child) if isinstance(child, ast.stmt | ast.ExceptHandler) else lines
            for new in _variants(child, wording):
                change = f"{_text(child)} -> {_text(new)}"
                apply = partial(_put, node, name, i if isinstance(value, list) else None, child, new)
                yield Mutant(getattr(child, "lineno", at.start), at, where, change, apply)
            inner = (*scope, child.name) if isinstance(child, (*_FUNCTIONS, ast.ClassDef)) else scope
            named = where or (".".join(inner) if isinstance(child, _FUNCTIONS) else "")
            yield from _walk(child, inner, named, at, wording)


def _put(node: ast.AST, name: str, i: int | None, old: ast.AST, new: ast.AST) -> None:
    """Put a new node in an old one's place."""
    ast.fix_missing_locations(ast.copy_location(new, old))
    if i is None:
        setattr(node, name, new)
    else:
        getattr(node, name)[i] = new


def _header(node: ast.stmt | ast.ExceptHandler) -> range:
    """Lines of a statement without the statements in it."""
    body = getattr(node, "body", None)
    end = max(node.lineno, body[0].lineno - 1) if body else node.end_lineno or node.lineno
    return range(node.lineno, end + 1)


def _text(node: ast.AST) -> str:
    first, *rest = ast.unparse(node).splitlines()
    return " ".join([first, *(line.strip() for line in rest[:1]), *["..."] * (len(rest) > 1)])


def _is_left_alone(node: ast.AST, function: str) -> bool:
    if isinstance(node, ast.keyword) and node.arg == "strict":  # of zip: says what cannot be
        return True
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr) and not function:  # of types
        return True
    if isinstance(node, ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return True
    return isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"


def _variants(node: ast.AST, wording: bool) -> Iterator[ast.AST]:
    """Give what may stand in a node's place."""
    match node:
        case ast.Compare():
            for i, op in enumerate(node.ops):
                for other in _COMPARISONS[type(op)]:
                    yield ast.Compare(node.left, [*node.ops[:i], other(), *node.ops[i + 1 :]], node.comparators)
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            for i in range(len(node.values)):
                rest = node.values[:i] + node.values[i + 1 :]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.BinOp(op=op) if type(op) in _ARITHMETIC and not _is_text(node):
            yield ast.BinOp(node.left, _ARITHMETIC[type(op)](), node.right)
        case ast.BinOp(op=ast.BitOr() | ast.BitAnd()):
            yield from (node.left, node.right)
        case ast.AugAssign(op=op) if type(op) in _ARITHMETIC:
            yield ast.AugAssign(node.target, _ARITHMETIC[type(op)](), node.value)
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float() as value):
            yield ast.Constant(value * 1.5 if value else 1.0)
        case ast.Constant(value=str() as value) if not wording and " " not in value:
            yield ast.Constant(f"XX{value}")
        case ast.Constant(value=bytes() as value):
            yield ast.Constant(b"XX" + value)
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp | ast.Constant):
                other = copy.copy(node)
                other.test = ast.UnaryOp(ast.Not(), test)
                yield other
        case ast.Return(value=value):
            if value is None:
                yield ast.Pass()
            elif ast.unparse(value) != "None":
                yield ast.Return(ast.Constant(None))
        case ast.Raise() | ast.Expr(value=ast.Call() | ast.Await()):
            yield ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()
        case ast.Continue():
            yield ast.Break()
        case ast.Break():
            yield ast.Continue()
        case ast.ExceptHandler(type=kind, body=body):
            if not (isinstance(body[0], ast.Raise) and body[0].exc is None):
                yield ast.ExceptHandler(kind, node.name, [ast.Raise()])
        case ast.Tuple(elts=elements) if len(elements) > 1 and _are_errors(elements):
            for i in range(len(elements)):
                yield ast.Tuple(elements[:i] + elements[i + 1 :], ast.Load())
        case ast.Call(func=called, args=[first, second, *more]):
            starred = isinstance(first, ast.Starred) or isinstance(second, ast.Starred)
            if not starred and ast.unparse(called) not in _UNORDERED and ast.dump(first) != ast.dump(second):
                yield ast.Call(called, [second, first, *more], node.keywords)


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr) or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


def _are_errors(nodes: list[ast.expr]) -> bool:
    return all(ast.unparse(node).endswith(("Error", "Exception")) for node in nodes)
