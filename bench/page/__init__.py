"""``python -m bench page``: the overview of a large fleet in Chromium, from a cold cache to the end of its list."""

from bench.page.run import main

__all__ = ["main"]
