"""Contact geometry of a wheelset on a track: profiles, contact tables, equivalent conicity."""
