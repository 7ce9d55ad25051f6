"""Estimators of a wheelset's geometry behind one interface: motion in, curve and conicity out."""
