"""``treadwatch openapi``: the OpenAPI document, printed or written where it is committed."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import Annotated

import orjson
import typer

from api.app import describe


def document_text() -> str:
    """Return the document as it is committed."""
    return orjson.dumps(describe().openapi(), option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS).decode() + "\n"


def openapi(
    *, write: Annotated[bool, typer.Option("--write", help="Write it to the committed file instead.")] = False
) -> None:
    """Print the OpenAPI document, or write it to the file that is committed."""
    if not write:
        typer.echo(document_text(), nl=False)
        return
    with as_file(files("api") / "openapi.json") as path:
        path.write_text(document_text(), encoding="utf-8")
        typer.echo(f"written: {path}")
