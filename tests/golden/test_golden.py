"""Nails: numbers that a rewrite must not move. They say that an answer is the same, not that it is right.

`python -m tests.golden.test_golden` writes golden.json anew; do so only for a change that is meant to move answers, and
say in the commit which numbers moved and why.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.reference import Face, Parameters, Scene, apply_law, solve, terms
from softdeca.reference.problems import meshes

from ..laws_on_elements import LAWS, elements_of, energies_of

KEPT = Path(__file__).with_name("golden.json")
SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.3, "jawOpen": 0.4}
TOLERANCE = {"network": 1e-5, "corpus": 1e-4}
"""Relative, by the beginning of a name: float32 in networks, float16 in shards. Converged answers keep 1e-6."""

Numbers = dict[str, float]


@cache
def _space():
    return identities.Anny()


@cache
def _head(seed: int | None):
    space = _space()
    code = np.zeros(space.code_size)
    skin = space.skin(code)
    if seed is not None:
        code, skin = space.sample(np.random.default_rng(seed))
    return code, fit_head(load_template(space, level=1), skin)


def _lengths(name: str, vectors) -> Numbers:
    lengths = np.linalg.norm(vectors, axis=-1)
    return {f"{name}, mean": float(lengths.mean()), f"{name}, max": float(lengths.max())}


def fit() -> Numbers:
    """A random person's head: each wrap's place, both layers' volumes."""
    _, head = _head(3)
    numbers: Numbers = {}
    for wrap in ("skin_wrap", "muscle_wrap", "skull_wrap"):
        numbers |= _lengths(f"head, {wrap}", getattr(head, wrap).vertices)
    volumes = {name: float(getattr(head, name).volumes.sum()) for name in ("soft", "muscle")}
    return numbers | {f"head, volume of {name}": value for name, value in volumes.items()}


def targets() -> Numbers:
    """Blendshapes, and made-up weights of a seed."""
    code, head = _head(3)
    skin = expressions.blend(_space(), code, expressions.weights_of(SMILE)[None])[0]
    talk = expressions.conversation(np.random.default_rng(0), 60, rate=30.0)
    return {**_lengths("blendshapes", skin - head.skin.vertices), "conversation, mean weight": float(talk.mean())}


def face() -> Numbers:
    """A face that settles, and an expression of it: projective dynamics, FEniCSx and the neo-Hookean law."""
    code, head = _head(None)
    p = Parameters(soft_volume=1.1, gravity=2.0, mandible_scale_y=1.05)
    person = Face(head, parameters=p, choices={"cells": "tets"}, settling={"tolerance": 1e-9})
    neutral = person.settled()
    weights = expressions.weights_of({"mouthSmileLeft": 0.3, "mouthSmileRight": 0.2})
    shape = expressions.blend(_space(), code, weights[None])[0]
    scene = person.expression_scene(shape)
    numbers = _lengths("settled", neutral.displacement)
    near = solve(scene, start=neutral.positions, tolerance=1e-9, max_iterations=3000)
    same = solve(scene, solver="fenicsx", start=near.positions, tolerance=1e-6)
    other = solve(apply_law(scene, "neo-Hookean"), solver="fenicsx", start=near.positions, tolerance=1e-9)
    for name, answer in (("PD", near), ("FEniCSx, PD's energy", same), ("FEniCSx, neo-Hookean", other)):
        assert answer.is_balanced, (name, answer.reason)
        numbers |= _lengths(name, answer.positions - scene.vertices) | {f"{name}, energy": answer.energy}
    return numbers


def palsy() -> Numbers:
    """A smile of a face with one half paralysed."""
    code, head = _head(None)
    shape = expressions.blend(_space(), code, expressions.weights_of(SMILE)[None])[0]
    person = Face(head, parameters=Parameters(paralysis_left=0.8), choices={"cells": "tets"}, settling={})
    answer = solve(person.expression_scene(shape), tolerance=1e-9, max_iterations=3000)
    assert answer.is_balanced, answer.reason
    return _lengths("palsy", person.expression_skin(shape, answer.positions) - head.skin.vertices)


def laws() -> Numbers:
    """Each law on each element of FEniCSx: the largest displacement of a block that is pulled askew."""
    X, tets = meshes.block(2)
    top = meshes.vertices_at(X, 2, 1.0)
    held = np.concatenate([meshes.vertices_at(X, 2, 0.0), top])
    moved = X[held] + (held >= top.min())[:, None] * np.where(np.isin(held, top), 1.0, 0.0)[:, None] * [0.1, 0.05, 0.2]
    numbers: Numbers = {}
    for law in LAWS:
        for element in elements_of(law):
            scene = Scene(X, tets, (*energies_of(law), terms.Fixed(held, moved)))
            answer = solve(scene, solver="fenicsx", element=element, tolerance=1e-11)
            assert answer.is_balanced, (law, element, answer.reason)
            numbers[f"{law}, {element}, energy"] = answer.energy
    scene = Scene(X, tets, (*energies_of("NeoHookean"), terms.Fixed(held, moved)))
    numbers["NeoHookean, scikit-fem, energy"] = solve(scene, solver="skfem", tolerance=1e-11).energy
    return numbers


def network() -> Numbers:
    """The shipped network's frames."""
    from softdeca.surrogate import Surrogate

    code, skin = _space().sample(np.random.default_rng(3))
    rig = Surrogate.load().bind(skin, code, Parameters(soft_volume=1.3, soft_stiffness=3.0))
    weights = expressions.weights_of(SMILE)
    blended = expressions.blend(_space(), code, weights[None])[0]
    return _lengths("network", np.asarray(rig.frame(weights), dtype=np.float64) - blended)


def corpus() -> Numbers:
    """A shard of people who are spheres: what frames, sequences and derivatives hold."""
    from softdeca.surrogate.corpus.folder import Corpus
    from softdeca.surrogate.corpus.people import OfSpace
    from softdeca.surrogate.corpus.plan import PRESETS
    from softdeca.surrogate.corpus.reading import Table
    from softdeca.surrogate.corpus.spheres import Spheres

    space = Spheres(1)
    plan = replace(PRESETS["tiny"], identities=2, cells="tets")
    numbers: Numbers = {}
    with TemporaryDirectory() as folder:
        Corpus.from_plan(Path(folder), plan, OfSpace(space, space.mean, space.fit)).generate()
        for table, key in (("statics", "corrected"), ("responses", "expressions"), ("sequences", "corrected")):
            rows = Table(folder, table, None)
            values = [np.asarray(rows[k][key], dtype=np.float64) for k in range(len(rows))]
            numbers |= _lengths(f"corpus, {table}", np.concatenate([v.reshape(-1, 3) for v in values]))
    return numbers


PARTS: dict[str, Callable[[], Numbers]] = {
    part.__name__: part for part in (fit, targets, face, palsy, laws, network, corpus)
}


@pytest.mark.parametrize("part", PARTS)
def test_answers_are_those_of_before(part):
    if part in ("face", "laws"):
        pytest.importorskip("dolfinx")
    kept = json.loads(KEPT.read_text())[part]
    numbers = PARTS[part]()
    assert numbers.keys() == kept.keys()
    for name, value in numbers.items():
        share = next((s for begin, s in TOLERANCE.items() if name.startswith(begin)), 1e-6)
        assert value == pytest.approx(kept[name], rel=share), name


if __name__ == "__main__":
    KEPT.write_text(json.dumps({name: part() for name, part in PARTS.items()}, indent=1) + "\n")
