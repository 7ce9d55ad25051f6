"""Chunks that are sent over HTTP: streamed to the disk, never held whole, never read here."""
