"""Subcommands of ``treadwatch``, by subject: their arguments; what they do is in ``api.terminal``."""
