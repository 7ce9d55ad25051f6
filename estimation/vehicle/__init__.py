"""Vehicle classes, their equations of motion (Eq. 1-5), and the regressors that follow from them."""
