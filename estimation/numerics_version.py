"""The version of the numerics: what every stored estimate carries as ``code_version``.

Raise it in the same commit as a change of results. Trends and epochs of another version are computed again; a changed
comment, message or module computes nothing again. ``tests/estimation/test_numerics_version.py`` fails where results
differ from those recorded for this version.
"""

from __future__ import annotations

NUMERICS_VERSION = "16"
