"""Webhooks: what is sent, where it may be sent, when it is sent again, and who sends it."""
