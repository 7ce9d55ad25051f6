"""``python -m bench feed``: whether anybody misses an event of the feed, and how late it comes to 200 streams."""

from __future__ import annotations

from collections.abc import Sequence


def main(arguments: Sequence[str]) -> int:
    """Run it; writers and pollers, which are started by the dozen, do not wait for these imports."""
    from bench.feed.run import main as run  # noqa: PLC0415 - the same

    return run(arguments)
