"""Solvers of other packages on this framework's problems, each against FEniCSx of its own law."""
