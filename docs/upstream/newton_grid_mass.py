"""newton: the mass of add_soft_grid beside its volume times its density. Needs newton alone."""

import newton
import numpy as np
import warp as wp

CELLS, EDGE, DENSITY = (4, 4, 20), 0.05, 1000.0

for cells in ((1, 1, 1), CELLS, (16, 16, 80)):
    builder = newton.ModelBuilder()
    builder.add_soft_grid(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        dim_x=cells[0],
        dim_y=cells[1],
        dim_z=cells[2],
        cell_x=EDGE,
        cell_y=EDGE,
        cell_z=EDGE,
        density=DENSITY,
        k_mu=5e4,
        k_lambda=5e4,
        k_damp=0.0,
    )
    mass, expected = np.sum(builder.particle_mass), DENSITY * np.prod(cells) * EDGE**3
    print(
        f"{cells}: {mass:.3f} kg, volume times density {expected:.3f} kg, ratio {mass / expected:.2f}"
    )
