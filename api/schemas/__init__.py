"""Representations: what the API serves, one file a resource; made from records, never stored."""
