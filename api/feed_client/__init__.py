"""The reference client of the feed of alerts: what ``treadwatch feed`` does, over HTTP alone."""
