"""An answer to the open face benchmark by FElupe and pyamg, from the archive's files alone.

    python face_by_felupe.py FOLDER PROBLEM MESH ANSWER.vtu

FOLDER is the unpacked archive. Nothing of softdeca is imported: this is how somebody else's code takes part.
"""

import json
import sys
from pathlib import Path

import felupe
import meshio
import numpy as np
import pyamg
from scipy.sparse.linalg import cg

folder, problem, name, out = Path(sys.argv[1]), *sys.argv[2:5]
asked = json.loads((folder / "benchmark.json").read_text())
given = meshio.read(folder / "meshes" / f"{name}.vtu")
tets, layer = given.cells_dict["tetra"], given.cell_data_dict["layer"]["tetra"]
soft_growth = asked["problems"][problem]["loads"].get("soft_tissue_growth", 1.0)


class Tissue:
    """growth psi(F growth^(-1/3)) of a layer; the names and the lists are FElupe's."""

    x = [np.zeros((3, 3)), np.zeros(0)]

    def __init__(self, moduli, growth):
        self.law = felupe.NeoHookeCompressible(mu=moduli["mu_kPa"], lmbda=moduli["lambda_kPa"])
        self.root = growth ** (1 / 3)

    def gradient(self, x):
        return [self.law.gradient([x[0] / self.root, x[-1]])[0] * self.root**2, x[-1]]

    def hessian(self, x):
        return [self.law.hessian([x[0] / self.root, x[-1]])[0] * self.root]


def field_of(cells):
    return felupe.FieldContainer([felupe.Field(felupe.RegionTetra(felupe.Mesh(given.points, cells, "tetra")), dim=3)])


field, fields = field_of(tets), [field_of(tets[layer == number]) for number in (0, 1)]
forces = given.point_data.get(f"force_{problem}_mN", np.zeros(given.points.shape))
moved = given.point_data["held_displacement_jaw_mm"] * (problem == "jaw")
held = np.repeat(given.point_data["held"] > 0, 3)
centred = given.points - given.points.mean(axis=0)
rigid = np.zeros((len(centred), 3, 6))
for axis in range(3):
    rigid[:, axis, axis] = 1.0
    rigid[:, :, 3 + axis] = np.cross(np.eye(3)[axis], centred)


def solve_linear(matrix, right):
    near_null = rigid.reshape(-1, 6)[~held]
    multigrid = pyamg.smoothed_aggregation_solver(matrix.tobsr((1, 1)), B=near_null, max_coarse=300)
    return cg(matrix, right, rtol=1e-8, maxiter=500, M=multigrid.aspreconditioner())[0]


STEPS = 4  # FElupe takes whole steps of Newton's, which in one go could turn tets inside out
for step in range(1, STEPS + 1):
    share, growths = step / STEPS, (1.0 + step / STEPS * (soft_growth - 1.0), 1.0)
    parts = zip(asked["law"]["layers"], growths, fields, strict=True)
    bodies = [felupe.SolidBody(Tissue(moduli, growth), each) for moduli, growth, each in parts]
    load = felupe.PointLoad(field, np.arange(len(forces)), values=forces * share)
    ended = felupe.newtonraphson(
        items=[*bodies, load], x0=field, dof0=np.flatnonzero(held), dof1=np.flatnonzero(~held),
        ext0=(moved * share).ravel()[held], solver=solve_linear, tol=1e-8, maxiter=20, verbose=0,
    )  # fmt: skip
    assert ended.success, f"step {step} did not converge"
unbalanced = sum(item.assemble.vector().toarray() for item in (*bodies, load)).reshape(-1, 3)
stress = np.empty((len(tets), 9))
for number, body in enumerate(bodies):  # FElupe's last two axes are points and tets
    stress[layer == number] = body.evaluate.cauchy_stress().mean(axis=-2).reshape(9, -1).T
meshio.Mesh(
    given.points,
    [("tetra", tets)],
    point_data={"displacement": field[0].values, "reaction": np.where(held.reshape(-1, 3), unbalanced, 0.0)},
    cell_data={"cauchy": [stress]},
).write(out)
print(f"{problem}, {name}: wrote {out}")
