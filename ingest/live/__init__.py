"""A live bus in, receipts out: what is received is on the disk within a second, and stays there until its receipt."""
