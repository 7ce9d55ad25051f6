"""REST routes, one file a group of resources; what one wheelset has is in ``geometry`` and ``wheelsets``."""
