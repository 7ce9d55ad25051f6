"""Estimators of a wheelset's geometry behind one interface, so that they can be compared on the same motion."""
