"""Keeping what is stored: backup and restore, the deep check, orphaned files, retention."""
