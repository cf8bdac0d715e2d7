"""Cost against size, processors and processes."""
