"""Profile files of wheels and rails in, a ``Profile`` out."""

from ingest.profiles.files import format_names, read_profile

__all__ = ["format_names", "read_profile"]
