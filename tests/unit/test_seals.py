"""Sealed mouths are noticed and opened; solid and closed eyes are told; what stays sealed is named and gated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix, identity

from softdeca.lhm import MeshError, Surface, check_head
from softdeca.lhm.arkit import ARKIT
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.deformation import greatest_stretches, torn_area
from softdeca.lhm.base.geometry.rays import first_hits
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import close_openings, find_openings, is_closed
from softdeca.lhm.fit import fit_registered, rig_from_space
from softdeca.lhm.identities.space import CAP, EYES, MOUTH
from softdeca.lhm.openings import lid_path, lip_path
from softdeca.lhm.registration import register_by_mapping
from softdeca.lhm.registration.registration import skin_ties, template_ties
from softdeca.lhm.rig import Rig
from softdeca.lhm.scans import lips, mouth, seals
from softdeca.lhm.scans.eyes import REACH, Eyes, calm_lids, classify_eyes
from softdeca.lhm.scans.slit import cut_slit
from softdeca.lhm.wraps.landmarks import distance_to

from ..refusals import refused


def shape(template, *names):
    return sum(template.space.expressions[ARKIT.index(name)] for name in names)


def without(template, part):
    return template.skin.triangles[~(template.parts[template.skin.triangles] == part).any(axis=1)]


def visible_parts(template):
    """The template's parts, of the lining also what of the lips is hidden from the front."""
    x, triangles = template.skin.vertices, template.skin.triangles
    near = distance_to(x, x[template.marks.rim]) < 6.0
    before = first_hits(TriangleTree(x, triangles), x + [0, 0, 30.0], np.tile([0.0, 0, -1], (len(x), 1)), 40.0)[1]
    return np.where(near & (before < 29.7), MOUTH, template.parts)


@pytest.fixture(scope="module")
def sealed(template):
    """The template's skin as a scanner sees it: its lips sewn together where one vanishes behind the other."""
    parts = visible_parts(template)
    x, triangles = template.skin.vertices, template.skin.triangles
    upper, lower = lips.split_rim(triangles, x, parts)
    kept = triangles[~(parts[triangles] == MOUTH).any(axis=1)]
    sewn = mouth._strip(upper, lower, x, kept)
    return Surface(x, np.vstack([kept, sewn[(sewn != np.roll(sewn, 1, axis=1)).all(axis=1)]]))


@pytest.fixture(scope="module")
def laid(template, sealed):
    n = len(template.skin.vertices)
    return register_by_mapping(template.skin, template.parts, identity(n, format="csr"), sealed)


@pytest.fixture(scope="module")
def opened(template, laid, sealed):
    return mouth.open_mouth(template.skin, template.parts, laid, sealed)


def test_stretches_are_the_singular_values_of_the_gradient():
    rng = np.random.default_rng(0)
    rest = rng.standard_normal((3, 3))
    gradient = rng.standard_normal((3, 3))
    plane = np.linalg.qr((rest[1:] - rest[0]).T)[0]
    expected = np.linalg.svd(gradient @ plane, compute_uv=False)[0]
    triangle = np.array([[0, 1, 2]])
    assert greatest_stretches(rest, rest @ gradient.T, triangle)[0] == pytest.approx(expected)
    assert torn_area(rest, 6 * rest, triangle) == pytest.approx(36 * Surface(rest, triangle).areas[0])
    assert torn_area(rest, 4 * rest, triangle) == 0.0


def test_a_slit_is_one_opening_and_leaves_the_surface_where_it_was():
    x, triangles = geodesic_sphere(8)
    front = (x[triangles][:, :, 2] > 0).all(axis=1)
    cut = cut_slit(triangles, x[:, 1] - 0.1 * x[:, 0], x[:, 0], (-0.5, 0.5), front, x)
    y = cut.on(x)
    loops = find_openings(cut.triangles)
    assert len(loops) == 1 and len(loops[0]) == 2 * len(cut.upper) - 2
    assert is_closed(close_openings(Surface(y, cut.triangles)).triangles)
    assert Surface(y, cut.triangles).areas.sum() == pytest.approx(Surface(x, triangles).areas.sum())
    np.testing.assert_array_equal(y[cut.upper], y[cut.lower])
    assert (cut.upper == cut.lower).sum() == 2 and np.ptp(y[cut.upper, 0]) > 0.8
    assert np.abs(y[cut.upper, 1] - 0.1 * y[cut.upper, 0]).max() < 0.03
    # Above the cut nothing knows the lower side's vertices, nor below it the upper's.
    for side, other in ((cut.upper[1:-1], 1), (cut.lower[1:-1], -1)):
        corners = cut.triangles[np.isin(cut.triangles, side).any(axis=1)]
        old = corners[corners < len(x)]
        assert (other * (x[old, 1] - 0.1 * x[old, 0]) >= 0).all()


@pytest.mark.parametrize(("height", "words"), [(2.0, "too coarse"), (0.0, "broken")])
def test_a_line_that_is_not_on_the_surface_is_refused(height, words):
    x, triangles = geodesic_sphere(8)
    kept = (x[triangles][:, :, 2] > 0.8).all(axis=1)
    refused(words, cut_slit, triangles, x[:, 1] - height, x[:, 0], (-0.9, 0.9), kept, x, error=MeshError)


def test_sealed_lips_are_told_from_open_ones(template, sealed, laid):
    for skin, expected in ((sealed, True), (template.skin, False)):
        line = lips.find_lip_line(template.skin, template.parts, laid.surface, skin)
        assert mouth.is_sealed(line, skin) is expected
    # A hole where the mouth is, and the lips of a head that is sealed at its eyes.
    hole = Surface(template.skin.vertices, without(template, MOUTH))
    assert not mouth.is_sealed(lips.find_lip_line(template.skin, template.parts, laid.surface, hole), hole)


def test_the_line_between_the_lips_is_found_beside_the_registered_one(template, sealed, laid):
    here = lips.find_lip_line(template.skin, template.parts, laid.surface, sealed)
    slid = laid.surface.with_vertices(laid.surface.vertices + [0.0, 2.0, 0.0])
    there = lips.find_lip_line(template.skin, template.parts, slid, sealed)
    inner = np.abs(here.along) < 0.7 * here.along[-1]
    off = np.abs((there.height + 2.0) - here.height)[inner]
    assert off.mean() < 0.5


def test_an_opened_mouth_moves_as_the_templates(template, sealed, opened):
    skin, n = opened.skin, len(sealed.vertices)
    assert is_closed(skin.triangles)
    # What was there stays where it was.
    np.testing.assert_array_equal(skin.vertices[:n], sealed.vertices)
    used = np.unique(sealed.triangles)
    for name, least in (("jawOpen", 0.97), ("mouthFunnel", 0.95), ("mouthSmileLeft", 0.98), ("browInnerUp", 0.99)):
        own = shape(template, name)
        found = opened.laid.skin_weights @ own
        a, b = own[used].ravel(), found[used].ravel()
        assert a @ b / np.linalg.norm(a) / np.linalg.norm(b) > least, name
        back = opened.laid.template_weights @ found
        a, b = own.ravel(), back.ravel()
        assert a @ b / np.linalg.norm(a) / np.linalg.norm(b) > least, name
    for weights in (opened.laid.skin_weights, opened.laid.template_weights):
        np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1.0, atol=1e-9)
    own = {"mouthSmileLeft": shape(template, "mouthSmileLeft")}
    carried = opened.carried(own)["mouthSmileLeft"]
    assert carried.shape == skin.vertices.shape
    np.testing.assert_array_equal(carried[:n], own["mouthSmileLeft"])


def test_the_gate_tells_a_membrane_and_the_rig_names_it(template, sealed, laid):
    left, up = (way(template, laid, sealed, {}) for way in (seals.keep_seals, seals.open_seals))
    assert left.sealed and not up.sealed
    assert "mouth: sealed, and left so" in left.notes and "mouth: sealed; opened" in up.notes[0]
    heads = {}
    for name, done in (("left", left), ("up", up)):
        head = fit_registered(template, done.skin, done.laid)
        heads[name] = replace(head, rig=seals.mark_rig(head.rig, done, head))
    torn = {name: check_head(head).jaw_open_torn for name, head in heads.items()}
    assert torn["left"] > 900 and torn["up"] < 200
    assert any("jaw open torn" in problem for problem in check_head(heads["left"]).problems)
    assert "jawOpen" in heads["left"].rig.doubtful and "browInnerUp" not in heads["left"].rig.doubtful
    assert not heads["up"].rig.doubtful
    # The template's own head opens its mouth without a tear.
    own = replace(template.head, rig=rig_from_space(template.space, template.skin))
    assert check_head(own).jaw_open_torn < 50 and check_head(own).blink_torn < 50


def test_a_skin_with_its_own_jaw_is_left_as_it_is(template, sealed, laid):
    done = seals.open_seals(template, laid, sealed, {"jawOpen": shape(template, "jawOpen")})
    assert done.skin is sealed and not done.sealed


def test_eyes_are_told_open_solid_and_closed(template, laid):
    def eyes(skin):
        space, parts, lids = template.space, template.parts, template.marks.lids
        return classify_eyes(space, template.skin, parts, lids, laid.surface, skin)

    assert eyes(template.skin) == Eyes("open", "open")
    outside = without(template, EYES)
    solid = close_openings(Surface(template.skin.vertices, outside))
    assert eyes(solid) == Eyes("solid", "solid")
    x = template.skin.vertices + shape(template, "eyeBlinkLeft")
    told = eyes(Surface(x, template.skin.triangles))
    assert told.left == "closed" and told.right == "open" and told.told().startswith("left eye: closed")
    assert set(told.still) >= {"eyeBlinkLeft", "eyeWideLeft"} and not any(name.endswith("Right") for name in told.still)
    rims = told.still_rims(template.skin, template.parts, template.marks.lids)
    assert len(rims) and (template.skin.vertices[rims, 0] > 0).all()


def test_lids_laid_on_what_has_no_lids_are_not_made_out(template):
    # Above the brows there is no edge for the rims of the lids to lie at.
    solid = close_openings(Surface(template.skin.vertices, without(template, EYES)))
    away = template.skin.with_vertices(template.skin.vertices + [0, 30.0, -2.0])
    space, lids = template.space, template.marks.lids
    told = classify_eyes(space, template.skin, template.parts, lids, away, solid)
    assert told == Eyes("unclear", "unclear") and "not made out" in told.told() and "eyeBlinkLeft" in told.still


def test_lids_that_stay_still_go_with_what_is_around_them(template):
    skin, lids = template.skin, template.marks.lids
    rng = np.random.default_rng(0)
    rims = skin.vertices[lids]
    near = distance_to(skin.vertices, rims) < REACH
    deltas = np.tile([1.0, -2, 3], (len(ARKIT), len(skin.vertices), 1))
    deltas[:, near] += rng.standard_normal((len(ARKIT), near.sum(), 3))
    own = {"jawOpen": deltas[ARKIT.index("jawOpen")]}
    calm = calm_lids(Rig(deltas, "a test"), skin, rims, own).deltas
    jaw = ARKIT.index("jawOpen")
    np.testing.assert_array_equal(calm[jaw], deltas[jaw].astype(np.float32))
    np.testing.assert_allclose(np.delete(calm, jaw, axis=0), np.tile([1.0, -2, 3], (51, len(near), 1)), atol=1e-3)


def test_a_squint_does_not_crumple_closed_lids():
    # A plane of 1 mm squares, of which what is below the line of the lids moves up by 3 mm.
    side = np.arange(-20.0, 21)
    x = np.array([[a, b, 0] for b in side for a in side])
    a = np.array([41 * i + j for i in range(40) for j in range(40)])
    skin = Surface(x, np.vstack([np.stack([a, a + 1, a + 42], axis=1), np.stack([a, a + 42, a + 41], axis=1)]))
    deltas = np.zeros((len(ARKIT), len(x), 3))
    fades = np.clip((20 + x[:, 1]) / 10, 0, 1) * np.clip(1 - (x[:, 0] / 13) ** 2, 0, 1)
    deltas[:, :, 1] = np.where(x[:, 1] < 0, 3.0 * fades, 0.0)
    rims = x[(x[:, 1] == 0) & (np.abs(x[:, 0]) < 13)]
    smooth = calm_lids(Rig(deltas, "a test"), skin, rims, {}).deltas
    near = distance_to(x, rims) < REACH - 1
    triangles = skin.triangles[near[skin.triangles].all(axis=1)]
    turned = [(Surface(x + d[0], triangles).face_normals[:, 2] < 0).sum() for d in (deltas, smooth)]
    assert turned[0] > 20 and turned[1] == 0
    assert greatest_stretches(x, x + smooth[0], triangles).max() < 1.5


def test_lip_and_lid_gates_do_not_depend_on_the_orientation(template):
    wrap, regions = template.skin_wrap, template.regions
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    turned = wrap.vertices @ turn.T + [3.0, 4, 5]
    lids, there = (lid_path(x, wrap.triangles, regions) for x in (wrap.vertices, turned))
    assert lids == pytest.approx(there)
    assert lip_path(wrap.vertices, wrap.triangles, regions) == pytest.approx(lip_path(turned, wrap.triangles, regions))


def test_tets_that_an_open_jaw_inverts_are_counted_and_gated(template, monkeypatch):
    from softdeca.reference.face import check

    head = replace(template.head, rig=rig_from_space(template.space, template.skin))
    jaw, blink = check.check_posed_head(head)
    assert 0 <= jaw.value < 20 and 0 <= blink.value < 20 and not jaw.missed and not blink.missed
    # A jaw that opens twice as wide tears through the neck.
    deltas = np.array(head.rig.deltas)
    deltas[ARKIT.index("jawOpen")] *= 2.2
    wide = replace(head, rig=replace(head.rig, deltas=deltas))
    assert check.check_posed_head(wide)[0].value > jaw.value
    monkeypatch.setattr("softdeca.lhm.check.INVERTED", check.check_posed_head(wide)[0].value - 1)
    assert check.check_posed_head(wide)[0].missed
    assert check.check_posed_head(template.head) == ()


@pytest.fixture(scope="module")
def membrane(template):
    """The template's skin without lining and sockets, their openings closed by fans: sealed behind the lips."""
    drawn = template.skin.vertices + shape(template, "eyeBlinkLeft", "eyeBlinkRight")
    outside = template.skin.triangles[~np.isin(template.parts, (MOUTH, EYES))[template.skin.triangles].any(axis=1)]
    n = len(drawn)
    skin = close_openings(Surface(drawn, outside))
    known = csr_matrix((np.ones(n), (np.arange(n), np.arange(n))), shape=(n, len(skin.vertices)))
    laid = register_by_mapping(template.skin, template.parts, known, skin)
    # What is tied is found, as after a registration: the fans' middles lie on nothing.
    surface = laid.surface
    ties = {
        "skin_weights": skin_ties(surface, skin),
        "template_weights": template_ties(surface, skin, template.parts == CAP),
    }
    return skin, replace(laid, **ties)


def test_a_membrane_deep_between_overlapping_lips_is_cut_and_closed_lids_stay_still(template, membrane):
    skin, laid = membrane
    # No way from lip to lip is straight there, but an open jaw would draw the membrane out.
    assert not mouth.is_sealed(lips.find_lip_line(template.skin, template.parts, laid.surface, skin), skin)
    left, up = seals.keep_seals(template, laid, skin, {}), seals.open_seals(template, laid, skin, {})
    assert left.sealed and not up.sealed
    assert any("mouth: sealed; opened" in note for note in up.notes)
    assert any("eyes: closed" in note for note in up.notes), up.notes
    torn = []
    for done in (left, up):
        head = fit_registered(template, done.skin, done.laid)
        head = replace(head, rig=seals.mark_rig(head.rig, done, head))
        torn.append(check_head(head).jaw_open_torn)
        assert check_head(head).blink_torn == 0.0 and "eyeBlinkLeft" in head.rig.doubtful
    assert torn[0] > 400 and torn[1] < 150
