"""Reasons are compared by their codes: no package compares or searches the sentence of one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("estimation", "fleet_db", "ingest", "api")
SENTENCES = {"text", "reason"}
SEARCHES = {"startswith", "endswith", "find", "index", "count"}


def compared_sentences(tree: ast.AST) -> Iterator[int]:
    """Yield the lines on which the text of a reason is compared with a sentence or searched."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
            if any(map(is_sentence, operands)) and any(map(is_literal, operands)):
                yield node.lineno
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in SEARCHES
            and is_sentence(node.func.value)
        ):
            yield node.lineno


def is_sentence(node: ast.expr) -> bool:
    """Return whether it is an attribute that holds a sentence."""
    return isinstance(node, ast.Attribute) and node.attr in SENTENCES


def is_literal(node: ast.expr) -> bool:
    """Return whether it is a text that is not empty, or several."""
    if isinstance(node, ast.Set | ast.Tuple | ast.List):
        return any(map(is_literal, node.elts))
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(node.value)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_sentence_is_compared(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    found = [
        f"{file.relative_to(ROOT)}:{line}"
        for file in files
        for line in compared_sentences(ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert found == []


@pytest.mark.parametrize(
    "source", ['a.reason == "too slow"', 'r.text.startswith("no")', '"slow" in a.reason.text', 'r.text in {"a", "b"}']
)
def test_a_comparison_by_sentence_is_found(source: str) -> None:
    assert list(compared_sentences(ast.parse(source))) == [1]
