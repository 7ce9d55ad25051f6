"""What flows between the stages: frozen values with their units, statuses and reasons; arrays are read-only."""
