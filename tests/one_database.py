"""For tests of what is decided above the store, where the database makes no difference.

The store, its locks and its transactions are tried on both; so is each job, once.
"""

from __future__ import annotations

import pytest

on_sqlite = pytest.mark.parametrize("storage", ["sqlite"], indirect=True)
"""For tests whose fixtures start from ``storage``."""
url_on_sqlite = pytest.mark.parametrize("storage_url", ["sqlite"], indirect=True)
"""For tests whose fixtures start from ``storage_url``."""
in_turn = ["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)]
"""Databases of services and of the main job as a whole: what they do on PostgreSQL is not what most changes touch."""
