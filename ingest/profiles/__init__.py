"""Profile files of wheels and rails in, a ``Profile`` out."""
