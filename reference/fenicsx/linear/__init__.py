"""The assembled problem and its linear solvers: factors, conjugate gradients in multigrid, saddle points."""
