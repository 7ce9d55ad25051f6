"""One file a REST resource."""
