"""``treadwatch openapi``: the OpenAPI document, printed or written where it is committed."""

from __future__ import annotations

from typing import Annotated

import typer


def openapi(
    *, write: Annotated[bool, typer.Option("--write", help="Write it to the committed file instead.")] = False
) -> None:
    """Print the OpenAPI document, or write it to the file that is committed."""
    from importlib.resources import as_file, files

    from api.app import COMMITTED, document_text

    if not write:
        typer.echo(document_text(), nl=False)
        return
    with as_file(files("api") / COMMITTED) as path:
        path.write_text(document_text(), encoding="utf-8")
        typer.echo(f"written: {path}")
