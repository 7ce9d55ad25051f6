"""Pictures: matplotlib figures made without global state."""
