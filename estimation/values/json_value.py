"""What JSON can hold."""

from __future__ import annotations

JsonValue = str | float | int | bool | None | list["JsonValue"] | dict[str, "JsonValue"]
