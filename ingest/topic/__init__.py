"""A Kafka topic of references to chunks: from each committed receipt a reference, from each reference a receipt."""
