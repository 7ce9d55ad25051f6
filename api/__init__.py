"""Every face turned outwards: REST, command line."""
