"""The main study: one head, its expressions, every solver and the surrogate; run -> JSON and pictures -> HTML."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..lhm import check_head, expressions, fit_head, identities, load_template
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import replaced
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..reference import Parameters, facial_scene
from ..reference.projective import local_step_seconds, prepare
from ..surrogate.runtime import Surrogate
from ..viewer import Pose, Rig, face_page
from ..viewer.pictures import Panel, cut_away, strip
from . import learned
from .cases import Case, CaseResult, run_case
from .differences import difference, distances
from .gates import gates
from .harness import machine, run
from .report import page
from .studies.verification import Verification

VIEW_WORDS = "Turn it with the mouse or a finger. In the poses the solvers' own answers can be chosen and compared."


@dataclass(frozen=True)
class StudyConfig:
    """What to study.

    identities is 'anny' or 'ict:FILE'; expressions are sums of ARKit names, each optionally scaled, as
    'mouthSmileLeft*0.5+jawOpen'; gravity [g] of the scene that has no expression; surrogate:
    the weights to test, by default those that are shipped.
    """

    identities: str = "anny"
    out: Path = Path("out/study")
    expressions: tuple[str, ...] = (
        "jawOpen",
        "mouthSmileLeft+mouthSmileRight",
        "mouthPucker",
        "cheekPuff",
        "browInnerUp",
    )
    gravity: float = 3.0
    surrogate: Path | None = None


def run_study(config: StudyConfig, progress: OnProgress) -> dict:
    """Run all of it; write results.json, PNG pictures and index.html into config.out; return the results."""
    cases = [Case(text, expressions.parsed(text), Parameters()) for text in config.expressions]
    cases.append(Case(f"gravity {config.gravity:g} g", np.zeros(52), Parameters(gravity=config.gravity)))
    space = identities.from_text(config.identities)
    network = _network(config, space)
    with alone_in(config.out, "study"):
        return _run(config, space, network, cases, progress)


def _run(config: StudyConfig, space, network: Surrogate | None, cases: Sequence[Case], progress: OnProgress) -> dict:
    clock = _Clock()
    template = load_template(space, progress=progress)
    code = np.zeros(space.code_size)
    head = fit_head(template, space.skin(code))
    shapes = expressions.blend(space, code, np.array([case.weights for case in cases]))
    clock.lap("head")
    done: list[CaseResult] = []
    for i, (case, shape) in enumerate(zip(cases, shapes, strict=True)):

        def tell(what: str, done_cases: int = i) -> None:
            progress(f"scenes: {what}", done_cases / len(cases))

        done.append(run_case(head, case, shape, tell))
        progress(f"scenes: {case.name}", (i + 1) / len(cases))
    clock.lap("scenes")
    scene = facial_scene(head, cases[0].parameters, shapes[0])
    local_step = local_step_seconds(prepare(scene), repeats=30)
    verified = run(Verification(), config.out / "verification", progress=progress)
    clock.lap("verification")
    tested, skins = None, []
    if network is not None:
        tested = learned.tested(network, space, template, config.out / "surrogate", progress)
        shapes_of_space = space.expression_deltas(code)
        skins = [
            compare_surrogate(network, head, code, shapes_of_space, case, result)
            for case, result in zip(cases, done, strict=True)
        ]
    clock.lap("test of the surrogate, with its corpus")
    results = {
        "title": f"projective dynamics, FEniCSx and a surrogate on one head ({space.name})",
        "identities": space.name,
        "machine": machine.describe(),
        "head": [
            {"figure": figure.words, "value": figure.value, "unit": figure.unit, "limit": figure.limit}
            for figure in check_head(head).figures
        ],
        "cases": [result.record for result in done],
        "tets": len(head.tets),
        "local_step_ms": 1e3 * local_step,
        "verification": [values for row in verified.rows if row.done for values in row.values["outcomes"]],
        "unverified": [f"{row.case}, {row.method}: {row.reason}" for row in verified.rows if row.status == "failed"],
        "surrogate": tested,
        "seconds": clock.laps,
    }
    results["gates"] = gates(results)
    images = _draw(head, done, skins, progress)
    clock.lap("pictures")
    with replaced(config.out / "results.json") as path:
        path.write_text(json.dumps(_finite(results), indent=1, allow_nan=False))
    view = _view(results["title"], space, head, cases, done, network)
    with replaced(config.out / "index.html") as path:
        path.write_text(page(results, images, view))
    return results


def _network(config: StudyConfig, space) -> Surrogate | None:
    """The one that was asked for, else the one that is shipped for the space, if there is one."""
    if config.surrogate is not None:
        return Surrogate.load(config.surrogate)
    shipped = Surrogate.load()
    return shipped if shipped.space == space.name else None


def compare_surrogate(
    rig: Surrogate, head: LayeredHead, code: Floats, expressions: Floats, case: Case, result: CaseResult
) -> Floats:
    """The surrogate's skin [mm] of a case; its figures and those of plain blendshapes are added to the record."""
    bound = rig.bind(head.skin, code, case.parameters, expressions=expressions)
    rest = head.skin.vertices
    skin = np.asarray(bound.frame(case.weights), dtype=np.float64)
    result.record["skin"] |= {
        "surrogate to PD": asdict(difference(skin, result.pd_skin, rest)),
        "surrogate to FEniCSx, PD's energy": asdict(difference(skin, result.fem_skin, rest)),
        "surrogate to FEniCSx, neo-Hookean": asdict(difference(skin, result.neo_hookean_skin, rest)),
    }
    for label, step, answer in (
        ("surrogate", bound.frame, skin),
        ("blendshapes (T = S)", bound.blend, result.expression),
    ):
        result.record["points"].append(
            {
                "label": label,
                "milliseconds": _median_ms(partial(step, case.weights)),
                "rms": difference(answer, result.fem_skin, rest).rms,
            }
        )
    return skin


def _median_ms(step: Callable[[], object], repeats: int = 50) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        step()
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))


def _view(
    title: str, space, head: LayeredHead, cases: Sequence[Case], done: Sequence[CaseResult], network: Surrogate | None
) -> str:
    """The head in 3D, with what each solver makes of the expressions under the default parameters."""
    parameters, code = Parameters(), np.zeros(space.code_size)
    shapes, rigs = space.expression_deltas(code), []
    if network is not None:
        rigs.append(Rig.baked("surrogate", network.bind(head.skin, code, parameters, expressions=shapes)))
    poses = [
        Pose(case.name, case.weights, {"PD": found.pd_skin, "FEniCSx, neo-Hookean": found.neo_hookean_skin})
        for case, found in zip(cases, done, strict=True)
        if case.parameters == parameters
    ]
    return face_page(title, VIEW_WORDS, head, parameters, shapes, rigs, poses)


def _draw(head: LayeredHead, done: Sequence[CaseResult], skins: Sequence[Floats], progress: OnProgress):
    """PNG pictures by name: the head, and a strip per case; `skins` of the surrogate, none where there is none."""
    images = {"head": cut_away(head)}
    for i, result in enumerate(done):
        progress("pictures", i / len(done))
        simulated = head.skin.with_vertices(result.pd_skin)
        others = {"blendshapes - PD": result.expression, "neo-Hookean - PD": result.neo_hookean_skin}
        others |= {"surrogate - PD": skins[i]} if skins else {}
        errors = {text: distances(other, result.pd_skin) for text, other in others.items()}
        top = max(0.05, float(np.percentile(errors["blendshapes - PD"], 99.5)))
        panels = [Panel("target", head.skin.with_vertices(result.expression)), Panel("simulated (PD)", simulated)]
        panels += [Panel(text, simulated, error, top) for text, error in errors.items()]
        images[result.record["name"]] = strip(panels)
    progress("pictures", 1.0)
    return images


def _finite(value):
    """The same with None, which JSON can say, for every number that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Clock:
    """Seconds since the last lap, by name."""

    def __init__(self):
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = round(now - self._last, 2)
        self._last = now
