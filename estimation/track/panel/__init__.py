"""Passes in; alignment and curves of the wheelsets from one linear regression out."""
