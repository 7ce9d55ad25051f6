"""The formats of profile files that are read, by the suffix of a file."""

from __future__ import annotations

from ingest.profiles import miniprof, simpack

FORMATS = (miniprof.FORMAT, miniprof.MULTIPART_FORMAT, simpack.FORMAT)
"""A new format is a module with its ``FORMAT``, and its entry here."""


def format_names() -> str:
    """Return the formats and their suffixes as a text for help and messages."""
    named = [f"{item.name} ({', '.join(item.suffixes)})" for item in FORMATS]
    return f"{', '.join(named)}; any other suffix: two columns of text"
