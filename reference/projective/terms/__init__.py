"""Contributions of each term: energy, gradient, and its part of the system."""
