"""Records of the registry entered by file, command or REST: one way in, one set of rules."""
