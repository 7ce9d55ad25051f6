"""Equations of motion of a wheelset and its suspended mass (Eq. 1-5), and the regressors that follow from them."""
