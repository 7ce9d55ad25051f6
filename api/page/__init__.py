"""The page: static files that use the REST API as any other client does, and the routes that serve them."""
