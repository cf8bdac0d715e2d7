"""Heads: fitted, simulated, registered, and compared with measured depths."""
