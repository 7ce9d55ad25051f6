"""The signal catalogue (DBC)."""
