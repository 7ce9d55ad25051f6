"""How urgent each wheelset is, from what is known of it."""
