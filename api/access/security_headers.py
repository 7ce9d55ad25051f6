"""Headers that tell browsers what not to do with an answer."""

from __future__ import annotations

from collections.abc import Mapping

PAGE_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
"""Scripts and styles of our own files only, none inline; no frame around it."""
HTTPS_ONLY = "max-age=31536000"


def security_headers(*, https: bool, shared: bool) -> Mapping[str, str]:
    """Return the headers of an answer."""
    found = {
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Content-Security-Policy": PAGE_POLICY,
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "cross-origin" if shared else "same-origin",
    }
    if https:
        found["Strict-Transport-Security"] = HTTPS_ONLY
    return found
