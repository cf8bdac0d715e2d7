"""Ways to an equilibrium: Newton, minimisation, load paths, multipliers, and time."""
