"""Which URLs name a store of raw recordings; none of them may carry a password."""

from __future__ import annotations

from urllib.parse import urlsplit


def names_store(url: str) -> bool:
    """Return whether a URL is ``file:///absolute/path`` or ``s3://bucket/prefix``."""
    parts = urlsplit(url)
    if parts.query or parts.fragment or "@" in parts.netloc:
        return False
    if parts.scheme == "file":
        return not parts.netloc and len(parts.path) > 1
    return parts.scheme == "s3" and bool(parts.netloc)


def names_endpoint(url: str) -> bool:
    """Return whether a URL is ``https://host:port`` or ``http://host:port``.

    Args:
        url: Of an S3-compatible store.
    """
    parts = urlsplit(url)
    plain = "@" not in parts.netloc and not parts.path.strip("/") and not parts.query and not parts.fragment
    return parts.scheme in {"http", "https"} and bool(parts.hostname) and plain
