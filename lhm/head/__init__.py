"""A head: its layers, its file, and the gates that it has to pass."""
