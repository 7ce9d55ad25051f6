"""Measured and designed profiles from files: MiniProf, SIMPACK, two columns of text."""

from estimation.contact.readers.files import read_profile

__all__ = ["read_profile"]
