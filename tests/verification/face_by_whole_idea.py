"""An answer to the open face benchmark by docs/tutorials/whole_idea.py, from the archive's files alone.

    python face_by_whole_idea.py FOLDER PROBLEM MESH ANSWER.vtu

FOLDER is the unpacked archive. The law is the benchmark's; elements and Newton's method are the page's.
"""

import json
import sys
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import diags

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "tutorials"))
from whole_idea import Elements, Problem, factorise, newton

folder, problem, name, out = Path(sys.argv[1]), *sys.argv[2:5]
asked = json.loads((folder / "benchmark.json").read_text())
given = meshio.read(folder / "meshes" / f"{name}.vtu")
rest, tets, layer = given.points, given.cells_dict["tetra"], given.cell_data_dict["layer"]["tetra"]
moduli = asked["law"]["layers"]
mu, lmbda = (np.array([each[key] for each in moduli])[layer, None] for key in ("mu_kPa", "lambda_kPa"))
soft_growth = asked["problems"][problem]["loads"].get("soft_tissue_growth", 1.0)
forces = given.point_data.get(f"force_{problem}_mN", np.zeros(rest.shape))
moved = given.point_data["held_displacement_jaw_mm"] * (problem == "jaw")
held = given.point_data["held"] > 0


def neo_hookean(s):
    """mu/2 (Σ s² - 3) - mu ln J + lmbda/2 ln² J with its derivatives; infinite where J is not positive."""
    upright = s[:, 2:] > 0
    s = np.where(upright, s, 1.0)
    ln_J = np.log(s.prod(axis=1, keepdims=True))
    psi = mu / 2 * (np.sum(s**2, axis=1, keepdims=True) - 3) - mu * ln_J + lmbda / 2 * ln_J**2
    slope = (mu + (mu - lmbda * ln_J) / s**2)[:, :, None] * np.eye(3) + (lmbda / s)[:, :, None] / s[:, None]
    return np.where(upright, psi, np.inf)[:, 0], mu * s + (lmbda * ln_J - mu) / s, slope


def grown(growth):
    """growth psi(F growth^(-1/3)) in soft tissue."""
    root = np.where(layer == 0, np.cbrt(growth), 1.0)[:, None]

    def law(s):
        psi, p, slope = neo_hookean(s / root)
        return root[:, 0] ** 3 * psi, root**2 * p, root[:, :, None] * slope

    return law


tissue = Elements(rest, tets)
# Held points take the tissue between along, as a membrane would go.
laplacian = tissue.to_F.T @ diags(np.repeat(tissue.size, 3)) @ tissue.to_F
carried = moved.copy()
carried[~held] = factorise(laplacian[~held][:, ~held]).solve(-(laplacian @ moved)[~held])

STEPS = 2
x, none = rest, np.zeros(len(rest))
for share in np.arange(1, STEPS + 1) / STEPS:
    tissue.law = grown(1.0 + share * (soft_growth - 1.0))
    body = Problem(rest, [tissue], none, rest, share * forces, held, np.zeros(0, dtype=int))
    x = newton(body, x + carried / STEPS)
U, s, _ = tissue.stretch(x)
kirchhoff = tissue.law(s)[1] * s
stress = np.einsum("kai,ki,kbi->kab", U, kirchhoff / s.prod(axis=1, keepdims=True), U)
meshio.Mesh(
    rest,
    [("tetra", tets)],
    point_data={"displacement": x - rest, "reaction": np.where(held[:, None], body.energy(x)[1], 0.0)},
    cell_data={"cauchy": [stress.reshape(-1, 9)]},
).write(out)
print(f"{problem}, {name}: wrote {out}")
