"""The feed of alerts: filters, cursors, pages, and what waits for news."""
