"""Profile files of wheels and rails, as instruments and programs write them: MiniProf, SIMPACK, plain columns."""

from ingest.profiles.files import read_profile

__all__ = ["read_profile"]
