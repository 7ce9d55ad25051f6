"""Recordings of a bus: log files in, one ``FrameBatch`` out."""

from ingest.logs.blf_layout import write_blf
from ingest.logs.formats import SUFFIXES, read_log

__all__ = ["SUFFIXES", "read_log", "write_blf"]
