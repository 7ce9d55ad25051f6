"""``python -m bench chunks``: uploads from their first byte to their receipt."""

from __future__ import annotations

from bench.chunks.run import main

__all__ = ["main"]
