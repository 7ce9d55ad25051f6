"""Stores: the only SQL; value types in and out, never rows."""
