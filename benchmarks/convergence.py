"""How far the answer on a head's own mesh is from that of an ever finer one -> results.json and one HTML page.

Sub-layers 1, 2, 4 of each tissue show the error across the layers; a mesh split into eight, beside two sub-layers of
the unsplit surface, shows the one along it. Bones are prescribed, so that every mesh solves the same problem.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..lhm import expressions
from ..lhm.errors import InputError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..lhm.refine import refined_head
from ..reference import Parameters, Scene, facial_scene, prepare, solve
from . import machine
from .convergence_report import page
from .differences import difference
from .gates import at_most
from .richardson import limit_of_three, limit_of_two
from .throughput import default_head

THREE = ("jawOpen*0.5", "mouthSmileLeft+mouthSmileRight", "cheekPuff+mouthPucker*0.5")
SUB_LAYERS = (1, 2, 4)
ALONG = 2
"""Sub-layers of the unsplit surface that compare with the split head: a layer of tets split into eight has two."""
ORDER_ALONG = 1.0
"""Of the two surface levels, assumed: smooth answers show 2, but springs and borders of bone let less be trusted."""
QUADRATIC_TOLERANCE = 1e-5
ACCEPTED = 0.1
"""Mean discretisation error [mm] that is half of what a network adds."""


@dataclass(frozen=True)
class ConvergenceConfig:
    """Which expressions of the default head; `quadratic`: also P2 tets by FEniCSx on the head's mesh.

    Raises InputError for expressions that cannot be read, and for none.
    """

    expressions: tuple[str, ...] = THREE
    seed: int = 0
    quadratic: bool = False
    tolerance: float = 1e-7
    out: Path = Path("out/convergence")

    def __post_init__(self):
        if not self.expressions:
            raise InputError("expressions: there is none")
        for text in self.expressions:
            expressions.parsed(text)


def run_convergence(config: ConvergenceConfig, progress: OnProgress) -> dict:
    """Solve all meshes; write results.json and index.html into config.out; return the results.

    Raises InputError for a folder in which another run works.
    """
    with alone_in(config.out, "run of convergence"):
        begin = time.perf_counter()
        progress("convergence: the head", 0.0)
        space, code, head = default_head(config.seed)
        shapes = expressions.blend(space, code, np.array([expressions.parsed(text) for text in config.expressions]))
        targets = dict(zip(config.expressions, shapes, strict=True))
        results = {
            "title": f"discretisation error of the mesh of a head of {space.name}, seed {config.seed}",
            **mesh_convergence(head, targets, config.tolerance, progress, quadratic=config.quadratic),
            "tolerance": config.tolerance,
            "machine": machine.describe(),
            "seconds": round(time.perf_counter() - begin, 1),
        }
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        write_whole(config.out / "index.html", page(results).encode())
    return results


def mesh_convergence(
    head: LayeredHead,
    targets: Mapping[str, Floats],
    tolerance: float,
    progress: OnProgress,
    *,
    quadratic: bool = False,
) -> dict:
    """Solves of PD's energy on every mesh, and the errors of the head's own, for named targets (skin vertices, 3).

    Returns `solves` (a row per mesh and expression), `expressions` (a row each: orders, limits, errors [mm]) and gates.
    """
    finer = refined_head(head)
    meshes = [(0, count, head) for count in SUB_LAYERS] + [(1, ALONG, finer)]
    rows: list[dict] = []
    skins: dict[tuple[str, int, int], Floats] = {}
    for i, (surface, count, of) in enumerate(meshes):
        layers = (count, count) if surface == 0 else (1, 1)
        prepared = None
        for name, shape in targets.items():
            progress(f"convergence: surface level {surface}, {count} sub-layers, {name}", i / len(meshes))
            scene = facial_scene(of, Parameters(), shape, bones="prescribed", layers=layers)
            begin = time.perf_counter()
            prepared = prepared or prepare(scene)
            solution = prepared.solve(scene, tolerance=tolerance)
            skins[name, surface, count] = of.skin_after(shape, solution.positions[: len(of.bone)])
            rows.append(_row(name, surface, count, "P1", scene, solution, time.perf_counter() - begin))
    second = _quadratic(head, targets, rows, progress) if quadratic else {}
    found = [_errors(name, head, shape, skins, second.get(name)) for name, shape in targets.items()]
    progress("convergence", 1.0)
    return {"expressions": found, "solves": rows, "gates": convergence_gates(found, rows)}


def _row(name: str, surface: int, count: int, element: str, scene: Scene, solution, seconds: float) -> dict:
    return {
        "expression": name,
        "surface": surface,
        "sub_layers": count,
        "element": element,
        "vertices": len(scene.vertices),
        "tets": len(scene.tets),
        "iterations": solution.iterations,
        "converged": solution.converged,
        "energy": solution.energy,
        "inverted": int(np.count_nonzero(solution.volume_ratio <= 0.0)),
        "seconds": seconds,
    }


def _quadratic(
    head: LayeredHead, targets: Mapping[str, Floats], rows: list[dict], progress: OnProgress
) -> dict[str, Floats]:
    """Skins [mm] of quadratic tets on the head's own mesh, by name; their rows are added."""
    skins = {}
    for name, shape in targets.items():
        progress(f"convergence: quadratic tets, {name}", 0.99)
        scene = facial_scene(head, Parameters(), shape, bones="prescribed")
        begin = time.perf_counter()
        near = solve(scene, tolerance=QUADRATIC_TOLERANCE).positions
        solution = solve(scene, solver="fenicsx", element="P2", start=near, tolerance=QUADRATIC_TOLERANCE)
        skins[name] = head.skin_after(shape, solution.positions[: len(head.bone)])
        rows.append(_row(name, 0, 1, "P2", scene, solution, time.perf_counter() - begin))
    return skins


def _errors(
    name: str,
    head: LayeredHead,
    shape: Floats,
    skins: Mapping[tuple[str, int, int], Floats],
    quadratic: Floats | None,
) -> dict:
    """What the meshes say of one expression: the two limits, and the head's own mesh against both together."""
    rest = head.skin.vertices
    through = [skins[name, 0, count] for count in SUB_LAYERS]
    across = limit_of_three(*through)
    unsplit, split = skins[name, 0, ALONG], skins[name, 1, ALONG]
    along = limit_of_two(unsplit, split, ORDER_ALONG)
    both = across.positions + (along.positions - unsplit)
    return {
        "name": name,
        "moved_mm": float(np.linalg.norm(through[0] - rest, axis=1).max()),
        "order_across": across.observed,
        "order_across_used": across.used,
        "order_along_assumed": along.used,
        "gci_across_mm": across.index,
        "gci_along_mm": along.index,
        "across": {
            str(count): asdict(difference(skin, across.positions, rest))
            for count, skin in zip(SUB_LAYERS, through, strict=True)
        },
        "along": {
            "0": asdict(difference(unsplit, along.positions, rest)),
            "1": asdict(difference(split, along.positions, rest)),
        },
        "between_surfaces": asdict(difference(unsplit, split, rest)),
        "own_mesh": asdict(difference(through[0], both, rest)),
        "quadratic_to_own": None if quadratic is None else asdict(difference(through[0], quadratic, rest)),
        "quadratic_to_limit": None if quadratic is None else asdict(difference(quadratic, both, rest)),
    }


def convergence_gates(found: list[dict], rows: list[dict]) -> list[dict]:
    """What the meshes have to show: see `gates.at_most`."""
    whole = {(row["expression"], row["surface"], row["sub_layers"]): row for row in rows if row["element"] == "P1"}
    rises = sum(whole[f["name"], 1, ALONG]["energy"] > whole[f["name"], 0, 1]["energy"] for f in found)
    return [
        at_most("solves that did not reach what was asked", sum(not row["converged"] for row in rows), 0),
        at_most(
            "expressions whose energy is higher on the mesh split into eight (it may do all the other can)", rises, 0
        ),
        at_most(
            "mean discretisation error of the head's own mesh, worst expression [mm]",
            float(np.max([f["own_mesh"]["mean"] for f in found])),
            ACCEPTED,
            answer=False,
        ),
    ]
