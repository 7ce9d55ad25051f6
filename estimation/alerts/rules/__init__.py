"""The alert rules: facts about a wheelset in, findings out. One file a subject."""
