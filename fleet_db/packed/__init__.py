"""Value types as packed arrays, one file a type; what comes back has the same bits."""
