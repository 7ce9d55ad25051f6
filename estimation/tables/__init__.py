"""Motion in; a bin table of mergeable sufficient statistics out."""
