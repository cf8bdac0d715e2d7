"""How far apart solvers, laws, network and rules are: faces, effects, motion, and a cube of tissue."""
