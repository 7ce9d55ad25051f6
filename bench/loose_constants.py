"""Numbers of `estimation` that stand outside a value of parameters, for ``python -m bench house``.

A loose numeric constant is a name to which a module, a class or a default argument of `estimation` gives a number, or
something with numbers in it: a tuple, an array, a mapping, arithmetic of literals. Each name counts once.

Not loose are the fields of a frozen dataclass that is a value of parameters (its name ends as one of ``PARAMETERS``):
they are handed down, and they are in the provenance. Not counted are

- 0 and 1 as defaults of fields and arguments (nothing of it; as it is), and members of an enumeration;
- types with the range of a field (``Annotated``, ``Interval``), units of files (``FileUnit``), and places in a table;
- stages and jobs, which say how often they are due;
- values of parameters that are made here (``STEP = StepModel(...)``), and empty values (``Check(0.0, ...)``);
- what is derived from them (``np.array(CURVES.bend_nodes)``), and numbers that only tell names apart (``0, 1, 2``);
- ``DEFINED``: profiles as standards define them, and Kalker's table.

What is left are units and constants of physics and mathematics, sizes that equations and what is stored have, versions
of it, and how much may be entered and is shown.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PARAMETERS = re.compile(
    r"\w*(Parameters|Settings|Rule|Delays|Model|Limits|Gates|Uncertainty|Prior|Running|Std|Class|Layout|Scale|Wear|Fit"
    r"|Algorithm|Filter)"
)
UNCOUNTED = re.compile(r"\b(Annotated|Interval|FileUnit|Stage|Job|Served|SpeedBand)\(|\bAnnotated\[|\bdatetime\(")
NEUTRAL = frozenset({0, 1, -1})
DERIVING = NEUTRAL | {0.5, 2}  # in an expression of parameters
DEFINED = frozenset(
    {f"estimation/{name}.py" for name in ("contact/wheel_definitions", "contact/profiles", "vehicle/kalker")}
)


@dataclass(frozen=True)
class Loose:
    """One name, where it stands, and what it is given."""

    path: str
    line: int
    name: str
    value: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.name} = {self.value[:80]}"


def loose_constants(root: Path) -> Iterator[Loose]:
    """Yield every loose numeric constant of `estimation`."""
    for path in sorted((root / "estimation").rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if name not in DEFINED:
            yield from _of_body(name, ast.parse(path.read_text(encoding="utf-8")).body, inside=False)


def _of_body(path: str, body: list[ast.stmt], *, inside: bool) -> Iterator[Loose]:
    for node in body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            yield from _assigned(path, node, inside=inside)
        elif isinstance(node, ast.ClassDef) and not _is_parameters(node):
            yield from _of_body(path, node.body, inside=True)
        elif isinstance(node, ast.FunctionDef):
            yield from _defaults(path, node)


def _is_parameters(node: ast.ClassDef) -> bool:
    frozen = any("frozen=True" in ast.unparse(item) for item in node.decorator_list)
    return any("Enum" in ast.unparse(base) for base in node.bases) or (frozen and bool(PARAMETERS.fullmatch(node.name)))


def _assigned(path: str, node: ast.Assign | ast.AnnAssign, *, inside: bool) -> Iterator[Loose]:
    assert node.value is not None
    text = ast.unparse(node.value)
    if isinstance(node.value, ast.Call):
        made = ast.unparse(node.value.func)
        if PARAMETERS.fullmatch(made) or (made[:1].isupper() and _numbers(node.value) <= NEUTRAL):
            return
    if UNCOUNTED.search(text) or not _numbers(node.value) or (inside and _numbers(node.value) <= NEUTRAL):
        return
    derived = any(isinstance(part, ast.Name) and part.id.isupper() for part in ast.walk(node.value))
    if (derived and _numbers(node.value) <= DERIVING) or re.fullmatch(r"\(0(, \d)+\)", text):
        return
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    for name in target.elts if isinstance(target, ast.Tuple) else [target]:
        yield Loose(path, node.lineno, ast.unparse(name), text)


def _defaults(path: str, node: ast.FunctionDef) -> Iterator[Loose]:
    places = [*node.args.posonlyargs, *node.args.args]
    given = [*zip(places[len(places) - len(node.args.defaults) :], node.args.defaults, strict=True)]
    for argument, value in [*given, *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)]:
        if value is not None and _numbers(value) - NEUTRAL:
            yield Loose(path, node.lineno, f"{node.name}({argument.arg})", ast.unparse(value))


def _numbers(node: ast.expr) -> set[float]:
    """Return the numbers in an expression, but for those that only choose an item."""
    chosen = {id(item) for part in ast.walk(node) if isinstance(part, ast.Subscript) for item in ast.walk(part.slice)}
    constants = [part for part in ast.walk(node) if isinstance(part, ast.Constant) and id(part) not in chosen]
    return {one.value for one in constants if isinstance(one.value, int | float) and not isinstance(one.value, bool)}
