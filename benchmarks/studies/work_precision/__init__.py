"""Error against time, method by method."""
