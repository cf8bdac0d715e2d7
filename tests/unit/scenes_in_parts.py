"""Scenes that are read in parts, and a script that processes of mpirun solve them by."""

import pickle
import sys

import numpy as np
from mpi4py import MPI

from softdeca.reference import solve, terms
from softdeca.reference.fenicsx import read_scene
from softdeca.reference.materials import Incompressible, NeoHookean, StableNeoHookean

LOW, SIDE = 3, 7  # tags of the face that is held and of the one that is loaded
SOFT, FIRM = 1, 2


NEO_HOOKEAN = NeoHookean.from_young(10.0, 0.4)


def loaded(part, load=None, soft=NEO_HOOKEAN):
    side = part.boundary[part.boundary_tags == SIDE]
    return [
        terms.Hyperelastic(soft, tets=part.tags == SOFT),
        terms.Hyperelastic(StableNeoHookean.from_young(15.0, 0.3), tets=part.tags == FIRM),
        terms.Fixed(part.corners(part.boundary[part.boundary_tags == LOW])),
        terms.Traction(side, (0.3, 0.1, 0.2)) if load is None else terms.Pressure(side, load),
        terms.Gravity((0.0, 0.0, -9810.0), 1e-6),
    ]


def skinned(part):
    top = np.flatnonzero(part.vertices[:, 2] > 1.0 - 1e-9)
    skin = terms.SurfaceStrain(part.boundary[part.boundary_tags == SIDE], 2.0)
    return [*loaded(part), skin, terms.Target(top, part.vertices[top] + [0.1, 0.05, 0.1], 0.05)]


def incompressible(part):
    return loaded(part, soft=Incompressible(NeoHookean(10.0, 10.0)))


CASES = {
    "skin and springs": (skinned, {}),
    "quadratic": (skinned, {"element": "P2"}),
    "factors": (loaded, {"linear_solver": "mumps"}),
    "pressure": (lambda part: loaded(part, 0.2), {}),
    "Taylor-Hood": (incompressible, {"element": "P2P1"}),
    "Taylor-Hood by GMRES": (incompressible, {"element": "P2P1", "linear_solver": "block"}),
}


def main(file, out):
    """Solve every case, and write what the first process knows to `out`, one answer to an XDMF file beside it."""
    found = {}
    for name, (acts, options) in CASES.items():
        scene = read_scene(file, acts)
        solution = solve(scene, solver="fenicsx", tolerance=1e-12, **options)
        stress = MPI.COMM_WORLD.allreduce(scene.volumes @ solution.von_mises)
        counts = MPI.COMM_WORLD.allgather((len(scene.vertices), len(scene.tets)))
        found[name] = (
            scene.whole(solution.positions),
            solution.energy,
            scene.whole(solution.reactions),
            stress,
            counts,
        )
        if name == "skin and springs":
            scene.write(f"{out}.xdmf", solution)
    if MPI.COMM_WORLD.rank == 0:
        with open(out, "wb") as file:
            pickle.dump(found, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
