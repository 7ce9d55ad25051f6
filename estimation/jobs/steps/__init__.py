"""Steps that jobs share or are made of; a job itself is what the parent folder lists."""
