"""What to do to wheelsets when, from what is known of them."""
