"""The ruler of skins: what counts as moving, kinds of p, bones carried, and gates that no trivial rival passes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.studies.surrogate.gates import BOUNDS, TRIVIAL, make_gates
from softdeca.benchmarks.studies.surrogate.scores import ALL, GROUPS, UNSCALED, measure_wait, run_trials, score
from softdeca.lhm.base.errors import InputError
from softdeca.reference import Parameters
from softdeca.reference.face.bones import scale_skull
from softdeca.reference.face.settle import carry_skin
from softdeca.surrogate.corpus.face import Heads
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.mixture import STATIC, select_static
from softdeca.surrogate.corpus.people import people_from_text
from softdeca.surrogate.corpus.plan import PRESETS, CorpusPlan
from softdeca.surrogate.corpus.reading import Faces
from softdeca.surrogate.methods import (
    CARRIED,
    DERIVATIVES,
    HYPERNETWORK,
    METHODS,
    NETWORK,
    NETWORK_AND_DERIVATIVES,
    SETTLED,
)
from softdeca.surrogate.ruler import (
    MOVES,
    STRENGTHS,
    kind_of,
    kind_of_coefficients,
    measure,
    strength_of,
)
from softdeca.surrogate.trials import static_trials

PEOPLE = people_from_text("spheres:1")
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "surrogate"


def differing(parameters):
    """The static parameters that differ from their default."""
    return {n for n in STATIC if np.any(np.asarray(getattr(parameters, n)) != Parameters.info(n).default)}


def test_only_vertices_that_move_count():
    motion = np.array([[0.0, MOVES, 0.1, 0.3]])
    ruler = measure(np.array([[9.0, 9.0, 0.02, 0.06]]), motion)
    assert ruler.vertices == 2 and ruler.moved == pytest.approx(0.2)
    assert ruler.mean == pytest.approx(0.04) and ruler.largest == 0.06 and ruler.share == pytest.approx(0.2)
    still = measure(motion, 0.1 * motion)
    assert still.vertices == 0 and np.isnan(still.share)


def test_bones_alone_explain_nothing_of_the_ruler_s_motion(sphere_head):
    """Carried blendshapes leave all of it; the truth leaves none; and skin over bone goes where bone goes."""
    parameters = Parameters(mandible_scale_y=1.1)
    skin, rng = sphere_head.skin.vertices, np.random.default_rng(0)
    bumps = 0.2 * rng.normal(size=(3, *skin.shape))
    carried = carry_skin(sphere_head, parameters)
    truth = skin + carried + bumps
    rulers = [
        measure(np.linalg.norm(answer - truth, axis=-1), np.linalg.norm(truth - (skin + carried), axis=-1))
        for answer in (skin + carried, truth, skin)
    ]
    assert rulers[0].share == pytest.approx(1.0) and rulers[1].largest == 0.0 and rulers[2].share > 1.05
    on_bone = sphere_head.bone == 2
    moved = scale_skull(sphere_head, parameters) - sphere_head.skull_wrap.vertices
    np.testing.assert_allclose(carried[on_bone], moved[on_bone], atol=1e-9)
    assert np.abs(moved[on_bone]).max() > 0.5


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({}, "default"),
        ({"soft_stiffness": 3.0, "skin_bending": 1.0}, "materials"),
        ({"gravity": 3.0, "soft_stiffness": 2.0}, "gravity"),
        ({"gravity_x": 0.5}, "gravity"),
        ({"skin_growth": np.full(80, 1.2), "skin_bending": 5.0}, "volume and growth"),
        ({"soft_volume": 1.2, "muscle_volume": 0.9}, "volume and growth"),
        ({"mandible_scale_x": 0.9, "cranium_scale_y": 1.01}, "bones"),
        ({"paralysis_left": 1.0, "target_stiffness": 3.0}, "palsy"),
        ({"paralysis_left": 1.0, "soft_volume": 1.2}, "several"),
        ({"frequency": 3.0, "damping": 0.2}, "default"),
    ],
)
def test_a_kind_follows_from_what_differs_in_p(changed, kind):
    assert kind_of(differing(Parameters(**changed))) == kind_of(set(changed) & set(STATIC)) == kind


def test_a_corpus_face_has_the_kind_of_its_parameters():
    head = PEOPLE.head(PEOPLE.person(np.random.default_rng(0)))
    for number in range(60):
        drawn = PRESETS["fresh"].parameter_set(number)
        kind = kind_of_coefficients(select_static(drawn.coefficients))
        assert kind == kind_of(differing(drawn.parameters(head, PEOPLE.mean)))
        assert (kind == "materials") == (drawn.kind == "materials")


def test_each_expression_has_one_strength():
    names = [strength_of(np.eye(52)[3] * weight) for weight in (0.0, 0.39, 0.4, 0.69, 0.7, 1.0)]
    assert names == [name for name in STRENGTHS for _ in range(2)]


@pytest.fixture(scope="module")
def faces(tmp_path_factory):
    plan = CorpusPlan(
        identities=4, groups=3, frames=3, sequences=0, varying=0.3,
        kinds={"materials": 0.3, "single": 0.7}, sources={"hard": 1.0}, conversations=0, random=0, hard=3, seconds=2.0,
    )  # fmt: skip
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("corpus"), plan, PEOPLE)
    corpus.generate()
    return Faces(corpus.folder, None, heads=Heads(lambda: PEOPLE))


def test_trivial_rivals_are_scored_by_kind_with_what_their_users_wait_for(faces):
    methods = [METHODS[name] for name in (CARRIED, SETTLED, DERIVATIVES)]
    lines = score(run_trials(static_trials(faces), *methods), {group: group for group in GROUPS})
    scores = {(line["method"], line["kind"]): line for line in lines}
    kinds = {kind for _, kind in scores}
    assert {ALL, UNSCALED, "materials", *STRENGTHS} <= kinds
    for kind in kinds:
        assert scores["bones carried", kind]["share"] == pytest.approx(1.0, rel=1e-4)  # skins in single precision
    settled = scores["settled + blendshapes", "materials"]
    # Without an effect nothing settles, so that rival is blendshapes.
    assert settled["share"] == pytest.approx(1.0, abs=0.02)
    assert 0.0 < settled["mean"] < settled["p95"] < settled["largest"]
    frames = [scores["bones carried", name]["frames"] for name in STRENGTHS]
    assert sum(frames) == scores["bones carried", ALL]["frames"]
    carried, _, linear = (measure_wait(method, [faces.face(0)]) for method in methods)
    assert linear.bind > carried.bind and linear.head > 0.0


def test_a_corpus_keeps_how_bones_carry_and_a_face_without_a_head_is_refused_by_name(faces):
    scaled = next(face for k in range(len(faces)) if (face := faces.face(k)).carried.any())
    np.testing.assert_allclose(scaled.carried, scaled.live.carried, atol=0.02)
    for heads in (None, Corpus.open(faces.folder).heads()):
        with pytest.raises(InputError, match="a head .*is needed, but .*(nobody fits it|made from Python)"):
            _ = replace(scaled, heads=heads).live
        with pytest.raises(InputError, match="a head .*is needed"):
            _ = replace(scaled, heads=heads).without_kept().carried
    np.testing.assert_array_equal(scaled.without_kept().carried, scaled.live.carried.astype(np.float32))
    unscaled = next(face for k in range(len(faces)) if not (face := faces.face(k)).carried.any())
    assert not replace(unscaled, heads=None).without_kept().carried.any()


def test_a_kept_face_is_the_live_one_to_what_a_corpus_rounds(faces):
    """Offset, responses and first order of a corpus' face are what its own head gives anew."""
    face = faces.face(0)
    anew = face.without_kept()
    np.testing.assert_allclose(anew.offset, face.offset, atol=2e-3)
    np.testing.assert_allclose(anew.responses, face.responses, atol=2e-2)
    weights = np.full(52, 0.02)
    kept, live = (METHODS[DERIVATIVES].bind(each).frame(weights) for each in (face, face.live))
    np.testing.assert_allclose(kept, live, atol=1e-2)


def _committed():
    rows = json.loads((RESULTS / "study.json").read_text())["rows"]
    return [line for row in rows for line in row["values"]["rows"]]


@pytest.mark.parametrize("rival", TRIVIAL)
def test_no_trivial_rival_passes_a_gate_of_the_network(rival):
    scores = _committed()
    names = NETWORK, HYPERNETWORK
    planted = [line for line in scores if line["method"] not in names]
    planted += [line | {"method": name} for name in names for line in scores if line["method"] == rival]
    by_kind = make_gates(planted)[:-1]
    assert len(by_kind) == len(names) * len(BOUNDS) and not any(gate["passed"] for gate in by_kind)


@pytest.mark.parametrize("rival", [*TRIVIAL, DERIVATIVES])
def test_derivatives_without_a_network_fail_the_gate_of_both(rival):
    scores = _committed()
    planted = [line for line in scores if line["method"] != NETWORK_AND_DERIVATIVES]
    planted += [line | {"method": NETWORK_AND_DERIVATIVES} for line in scores if line["method"] == rival]
    assert not make_gates(planted)[-1]["passed"]
