"""Who may do what: scopes of operations, callers, and what of the database a caller sees."""
