"""What the commands do, with their progress and tables on the terminal; imported only when a command runs."""
