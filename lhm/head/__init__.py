"""What a head is: its layers, its file, and the gates that it has to pass."""
