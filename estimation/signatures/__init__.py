"""In: windows, and what the fleet knows of wheelsets. Out: wear signatures, and the conicity that they show."""
