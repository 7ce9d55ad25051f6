"""Lists as CSV in the OpenAPI document: every list is offered as a table, and its columns are written down."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts

from api.contract import CSV
from api.csv_tables import columns_of, item_of


def describe_tables(app: FastAPI, document: dict[str, Any]) -> None:
    """Add the table of every list to its success."""
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        item = item_of(route.response_model) if isinstance(route, APIRoute) and route.include_in_schema else None
        if item is None or not isinstance(route, APIRoute):
            continue
        columns = [column.name for column in columns_of(item)]
        listed = ", ".join(f"`{name}`" for name in columns)
        schema = {
            "type": "string",
            "description": f"A table (RFC 4180) with the columns {listed}. Cells that start like a formula have an "
            "apostrophe in front.",
        }
        for method in route.methods or ():
            content = document["paths"][route.path_format][method.lower()]["responses"]["200"]["content"]
            content[CSV] = {"schema": schema, "example": ",".join(columns) + "\r\n"}
