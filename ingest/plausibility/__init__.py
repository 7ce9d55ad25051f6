"""What a recording contains, checked against itself and its receipt; in: values of a recording, out: verdicts."""
