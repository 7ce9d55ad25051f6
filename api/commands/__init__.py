"""One file a subcommand of ``treadwatch``."""
