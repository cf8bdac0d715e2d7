"""One file per solver of another package, and what runs one of them in a process of its own.

A solver's file needs numpy and its own package, nothing of softdeca, so that an environment without it can run it.
"""

NAMES = (
    "felupe_newton",
    "sfepy_newton",
    "mujoco_flex",
    "newton_vbd",
    "torch_fem",
    "jax_fem_newton",
    "libigl_arap",
)
"""The files of this folder that are solvers, in the order of tables."""
