"""A bin table in; the four combinations and the equivalent conicity, each with its interval, out."""
