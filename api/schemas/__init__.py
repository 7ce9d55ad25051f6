"""Representations: what the API says, one file a resource; made from records, never stored."""
