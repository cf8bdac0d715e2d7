"""newton: a bar that hangs under its weight, by three solvers, at rest. Needs newton alone.

    python newton_bar.py            # SolverVBD by iterations and substeps
    python newton_bar.py moduli     # one k_mu and k_lambda in three solvers

Masses are a quarter of each tet's. All velocities are set to zero whenever the kinetic energy falls, so that the bar
comes to rest without damping.
"""

import sys
from itertools import permutations

import numpy as np
import warp as wp

wp.config.quiet = True
import newton  # noqa: E402

CELLS, EDGE, DENSITY, GRAVITY = (4, 4, 20), 0.05, 1000.0, 9.81
K_MU = K_LAMBDA = 5e4
SECONDS = 3.0


def build():
    """The model, the vertices and those of the bottom."""
    shape = np.array(CELLS) + 1
    X = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    first = X[(X < CELLS).all(axis=1)] @ strides
    tets = []
    for order in permutations(range(3)):  # six tets per cell, one per order of the axes
        tets.append(
            first[:, None] + np.concatenate([[0], np.cumsum(strides[list(order)])])
        )
    tets, X = np.concatenate(tets), X * EDGE
    volumes = np.linalg.det(X[tets[:, 1:]] - X[tets[:, :1]]) / 6.0
    tets[volumes < 0] = tets[volumes < 0][:, [0, 1, 3, 2]]
    masses = np.bincount(tets.ravel(), np.repeat(np.abs(volumes) * DENSITY / 4.0, 4))
    top, bottom = (
        np.flatnonzero(np.isclose(X[:, 2], CELLS[2] * EDGE)),
        np.flatnonzero(X[:, 2] == 0.0),
    )
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.add_soft_mesh(
        pos=(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*x) for x in X],
        indices=tets.ravel().tolist(),
        density=DENSITY,
        k_mu=K_MU,
        k_lambda=K_LAMBDA,
        k_damp=0.0,
        add_surface_mesh_edges=False,
        particle_radius=0.0,
    )
    builder.particle_mass = [
        0.0 if k in set(top) else float(mass) for k, mass in enumerate(masses)
    ]
    builder.color()
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, -GRAVITY))
    return model, X, bottom


def rest(make, substeps):
    """Mean extension [mm] of the bottom at rest."""
    model, X, bottom = build()
    solver, state, ahead, control, last = (
        make(model),
        model.state(),
        model.state(),
        model.control(),
        0.0,
    )
    masses = np.asarray(model.particle_mass.numpy())
    for _ in range(int(SECONDS * 60 * substeps)):
        state.clear_forces()
        solver.step(state, ahead, control, None, 1.0 / 60.0 / substeps)
        state, ahead = ahead, state
        energy = float(
            masses @ np.sum(state.particle_qd.numpy().astype(float) ** 2, axis=1)
        )
        if energy < last:
            state.particle_qd.zero_()
            energy = 0.0
        last = energy
    return 1e3 * float(np.mean((X - state.particle_q.numpy())[bottom, 2]))


def vbd(iterations):
    """The solver without contact."""
    return lambda model: newton.solvers.SolverVBD(
        model,
        iterations=iterations,
        particle_enable_self_contact=False,
        particle_enable_tile_solve=False,
    )


def xpbd(model):
    """The solver with a relaxation that its simultaneous corrections can bear."""
    return newton.solvers.SolverXPBD(model, iterations=20, soft_body_relaxation=0.05)


young = K_MU * (3 * K_LAMBDA + 2 * K_MU) / (K_LAMBDA + K_MU)
length = CELLS[2] * EDGE
print(
    f"small strain, one dimension: {1e3 * DENSITY * GRAVITY * length**2 / (2 * young):.1f} mm"
)
if sys.argv[1:] == ["moduli"]:
    print(f"SolverVBD, 20 iterations, 5 substeps: {rest(vbd(20), 5):.1f} mm")
    print(
        f"SolverSemiImplicit, 64 substeps: {rest(newton.solvers.SolverSemiImplicit, 64):.1f} mm"
    )
    print(f"SolverXPBD, 20 iterations, 5 substeps: {rest(xpbd, 5):.1f} mm")
else:
    for iterations, substeps in ((5, 1), (20, 1), (100, 1), (20, 5)):
        print(
            f"{iterations:>3} iterations, {substeps:>2} substeps: {rest(vbd(iterations), substeps):.1f} mm",
            flush=True,
        )
