"""A panel solution in; the gauge deviation and what it does to each wheel out."""
