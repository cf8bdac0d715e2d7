"""What each term adds: energy, gradient, and its part of the system."""
