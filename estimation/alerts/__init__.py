"""Facts about a wheelset in; alert transitions out."""
