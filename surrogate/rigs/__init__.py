"""Rigs: frames of a bound face, baked, and with inertia."""
