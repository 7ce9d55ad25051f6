"""Chunks handed in by others, over HTTP or through a folder: bytes in, receipts out; nothing is decoded here."""
