"""Parameters beyond what the network has seen, clamped to the nearest, beside simulation under what was asked for."""

from __future__ import annotations

import warnings

import numpy as np

from ....lhm import expressions, fit_head, identities, load_template
from ....lhm.base.mesh import Floats
from ....lhm.base.progress import OnProgress
from ....lhm.template import DEFAULT_LEVEL
from ....reference import Parameters, settle
from ....reference.face.derivatives import QUICK_ACCURACY, differentiate
from ....reference.face.settle import TARGET_OPTIONS, carry_skin
from ....surrogate import Surrogate
from ....surrogate.evaluate import Known, Score, score_distances
from ....surrogate.methods import BLENDSHAPES, CARRIED, NETWORK, SETTLED

KIND = "p beyond what was seen, clamped"
CASES = (
    Parameters(skin_growth=1.5, skin_bending=10.0),
    Parameters(muscle_strain_ratio=0.05),
    Parameters(strain_limit=1.2),
)
EXPRESSIONS = ({"jawOpen": 0.7}, {"mouthSmileLeft": 0.8, "mouthSmileRight": 0.8}, {"mouthPucker": 0.8, "jawOpen": 0.2})


def score_beyond(surrogate: Surrogate, progress: OnProgress, *, level: int = DEFAULT_LEVEL) -> list[Score]:
    """Score the network and its trivial rivals on CASES of the mean person, half a minute each; kind KIND."""
    space = identities.Anny()
    skin, code = space.mean, np.zeros(space.code_size)
    head = fit_head(load_template(space, level=level), skin)
    rows = [expressions.weights_of(expression) for expression in EXPRESSIONS]
    errors: dict[str, list[Floats]] = {}
    motions = []
    for number, parameters in enumerate(CASES):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            rig = surrogate.bind(skin, code, parameters, beyond="clamp")
        face = settle(head, parameters, **TARGET_OPTIONS)
        linear = differentiate(face, accuracy=QUICK_ACCURACY)
        for weights in rows:
            drawn = skin.vertices + np.tensordot(weights, space.expressions, axes=1)
            truth = face.skin_after(drawn, linear.solve(drawn).positions)
            carried = drawn + carry_skin(head, parameters)
            settled_there = drawn + face.displacement + linear.offset
            answers = {NETWORK: rig.frame(weights), CARRIED: carried, SETTLED: settled_there, BLENDSHAPES: drawn}
            for name, answer in answers.items():
                errors.setdefault(name, []).append(np.linalg.norm(answer - truth, axis=1))
            motions.append(np.linalg.norm(truth - carried, axis=1))
        progress(f"evaluate, {KIND}", (number + 1) / len(CASES))
    motion = np.stack(motions)
    return [
        score_distances(Known(name, simulates=name == SETTLED), KIND, np.stack(rows), motion, faces=len(CASES))
        for name, rows in errors.items()
    ]
