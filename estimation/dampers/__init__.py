"""Windows of a running gear -> the state of its lateral damper, by particles over its damping."""
