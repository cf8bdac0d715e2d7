"""FElupe: NeoHookeCompressible with moduli per cell, below and above 8,192 cells. Needs felupe alone."""

import felupe
import numpy as np

for n in (11, 13):
    mesh = felupe.mesh.triangulate(felupe.Cube(n=n))
    field = felupe.FieldContainer([felupe.Field(felupe.RegionTetra(mesh), dim=3)])
    solid = felupe.SolidBody(
        felupe.NeoHookeCompressible(
            mu=np.ones(mesh.ncells), lmbda=np.full(mesh.ncells, 9.0)
        ),
        field,
    )
    try:
        solid.assemble.vector()
        print(f"{mesh.ncells} cells: assembled")
    except ValueError as error:
        print(f"{mesh.ncells} cells: ValueError: {error}")
