"""Recordings of a bus: log files in and out."""

from ingest.logs.formats import SUFFIXES, read_log, write_log

__all__ = ["SUFFIXES", "read_log", "write_log"]
