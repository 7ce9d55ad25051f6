"""A window in; checked, integrated, track-relative motion out, or the reason why not."""
