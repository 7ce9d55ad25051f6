"""The lateral alignment of a place, from the fleet that passes it."""
