"""The archive of the open face benchmark: meshes, materials, loads, converged answers, a card and the scorer."""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ...lhm.base.files.atomic import replaced
from ...lhm.base.mesh import Floats
from ...reference.face.parameters import STANDARD_GRAVITY, TISSUE_DENSITY
from ...reference.materials import NeoHookean
from ...reference.materials.material import lame
from . import score
from .problems import BONES, GROWTH, MESHES, POISSON, PROBLEMS, YOUNG, Body, describe_measures

LAW = "psi = mu/2 (tr(F^T F) - 3) - mu ln J + lambda/2 (ln J)^2 per volume at rest, J = det F"
POINT_ARRAYS = {
    "held": "1 where a point is held, else 0",
    "held_displacement_jaw_mm": "where the problem jaw moves held points [mm]; other problems hold them at rest",
    "force_gravity_mN": "dead nodal forces [mN] of the problem gravity, exact for linear tets",
    "force_cheek_mN": "dead nodal forces [mN] of the problem cheek, exact for linear tets",
    **{bone: f"weight of a point's reaction in the force on the {bone}" for bone in BONES},
}


def write_archive(
    path: Path,
    bodies: Sequence[Body],
    limits: Mapping[str, Mapping[str, Any]],
    answers: Mapping[str, Floats],
    commit: str,
) -> int:
    """Write the archive of nested meshes, coarse ones first, and their answers; return its bytes.

    limits: by problem "answers", a list of quantities with "name", "unit", "value" and "band", and the bands [mm] of
    the coarse mesh's vertices: "band_mm" of their RMS and "largest_mm" of the farthest; answers: arrays [mm], named
    PROBLEM.converged of the coarse mesh's vertices, and PROBLEM.linear.MESH and PROBLEM.quadratic.MESH of all MESH has.
    """
    coarse = bodies[0]
    description = describe(bodies, limits, commit)
    files = {
        score.DESCRIPTION: json.dumps(description, indent=1, allow_nan=False).encode(),
        score.ANSWERS: _as_npz({"points": coarse.vertices, **answers}),
        "score.py": Path(score.__file__).read_bytes(),
        "README.md": write_card(description).encode(),
    }
    for name, body in zip(MESHES, bodies, strict=False):
        files[f"meshes/{name}.vtu"] = _as_vtu(body)
    sums = "".join(f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in files.items())
    with replaced(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in {**files, score.CHECKSUMS: sums.encode()}.items():
            archive.writestr(name, content)
    return path.stat().st_size


def describe(bodies: Sequence[Body], limits: Mapping[str, Mapping[str, Any]], commit: str) -> dict[str, Any]:
    """Describe the benchmark as benchmark.json holds it: materials, problems, quantities and their converged values."""
    coarse = bodies[0]
    layers = [
        {"name": name, "layer": number, "young_kPa": young, "poisson": POISSON}
        | dict(zip(("mu_kPa", "lambda_kPa"), lame(young, POISSON), strict=True))
        for number, (name, young) in enumerate(YOUNG.items())
    ]
    loads = {
        "gravity": {
            "density_kg_per_mm3": TISSUE_DENSITY,
            "acceleration_mm_per_s2": [0.0, -STANDARD_GRAVITY, 0.0],
        },
        "jaw": {"held_displacement": "held_displacement_jaw_mm"},
        "growth": {"soft_tissue_growth": GROWTH, "energy": f"{GROWTH} psi(F {GROWTH}^(-1/3)) in soft tissue"},
        "cheek": {
            "traction_kPa": coarse.push.tolist(),
            "triangles_of_coarse_mesh": coarse.patch.tolist(),
        },
    }
    return {
        "name": "open face benchmark",
        "version": 2,
        "commit": commit,
        "units": {"length": "mm", "force": "mN", "stress": "kPa", "mass": "kg", "time": "s"},
        "law": {"name": NeoHookean.__name__, "energy": LAW, "layers": layers},
        "meshes": {
            name: {"points": len(body.vertices), "tets": len(body.tets), "held": len(body.held_vertices)}
            for name, body in zip(MESHES, bodies, strict=False)
        },
        "point_arrays": POINT_ARRAYS,
        "cell_arrays": {"layer": "0 in soft tissue, 1 in muscle"},
        "bones": list(BONES),
        **describe_measures(coarse),
        "problems": {
            problem: {
                "text": text,
                "loads": loads[problem],
                "band_mm": limits[problem]["band_mm"],
                "largest_mm": limits[problem]["largest_mm"],
                "quantities": {
                    each["name"]: {key: each[key] for key in ("unit", "value", "band")}
                    for each in limits[problem]["answers"]
                },
            }
            for problem, text in PROBLEMS.items()
        },
    }


def write_card(description: Mapping[str, Any]) -> str:
    """Write the card: what is asked, the answers with their bands, how to score, licence and citation."""
    folder = FileSystemLoader(Path(__file__).parent)
    pages = Environment(loader=folder, trim_blocks=True, undefined=StrictUndefined, keep_trailing_newline=True)
    return pages.get_template("card.md").render(**description, norm=np.linalg.norm)


def _as_vtu(body: Body) -> bytes:
    count = len(body.vertices)
    held = np.isin(np.arange(count), body.held_vertices)
    values = (
        held.astype(np.int8),
        np.where(held[:, None], body.jaw, 0.0),
        body.scene("gravity").loads(),
        body.scene("cheek").loads(),
        *(body.shares[bone] for bone in BONES),
    )
    points, cells = dict(zip(POINT_ARRAYS, values, strict=True)), {"layer": [body.layer.astype(np.int8)]}
    mesh = meshio.Mesh(body.vertices, [("tetra", body.tets.astype(np.int32))], point_data=points, cell_data=cells)
    with tempfile.NamedTemporaryFile(suffix=".vtu") as file:
        mesh.write(file.name, file_format="vtu")
        return Path(file.name).read_bytes()


def _as_npz(arrays: Mapping[str, Floats]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()
