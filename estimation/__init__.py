"""The mathematics: contact geometry, vehicle equations, estimators, trends and rules. Pure."""
