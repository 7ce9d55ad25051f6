"""The geometry history of a wheelset in; its wear trend and forecast out."""
