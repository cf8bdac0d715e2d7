"""Gates of layered heads: each must be missed where its defect is made, and only there."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from softdeca.lhm import Surface, check_head, fit_head
from softdeca.lhm.base.geometry.tets import aspect_ratios, smallest_dihedrals
from softdeca.lhm.base.geometry.triangles import fan_crossings
from softdeca.lhm.head.file import save_head
from softdeca.lhm.head.gates import Figure, check_layers
from softdeca.lhm.head.openings import lid_path, lip_path
from softdeca.lhm.identities.arkit import ARKIT

RADII = (100.0, 92.0, 85.0)


def parts(subdivisions=3):
    sphere = trimesh.creation.icosphere(subdivisions)
    unit, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    bone = np.where(unit[:, 1] > 0.0, 1, np.where(unit[:, 1] < -0.8, 2, 0))
    return unit, faces, [radius * unit for radius in RADII], bone


def measured(faces, wraps, bone, regions=None, skin=None):
    surfaces = [Surface(x, faces) for x in wraps]
    return check_layers(Surface(wraps[0] if skin is None else skin, faces), surfaces, bone, regions or {})


def missed(report):
    return {gate.name for gate in report.gates if gate.missed}


def test_a_sound_head_passes_and_its_figures_follow_from_its_radii():
    unit, faces, wraps, bone = parts()
    report = measured(faces, wraps, bone)
    assert report.problems == ()
    assert report.least_thickness == pytest.approx(15) and report.mean_thickness == pytest.approx(15)
    assert report.least_soft_thickness == pytest.approx(8) and report.least_muscle_thickness == pytest.approx(7)
    # A muscle vertex lies 8 mm below the skin's vertex, and less than the sagitta closer to its flat triangles.
    assert -8 <= report.muscle_outside_skin_wrap < -7
    assert report.wrap_to_skin_max < 1e-9 and report.skin_to_wrap_max < 1e-9
    assert report.skull_outside_skin == 0 and report.skin_outside_wrap == 0
    assert (report.lip_path, report.lid_path, report.lid_detour) == (None, None, None)
    assert report.cranium_vertices + report.mandible_vertices + report.free_vertices == len(unit)


def test_a_skull_wrap_through_the_skin_is_counted_and_does_not_crash():
    unit, faces, wraps, bone = parts()
    wraps[2] = wraps[2].copy()
    wraps[2][0] = 1.2 * wraps[0][0]
    report = measured(faces, wraps, bone)
    names = missed(report)
    assert {"inverted_tets", "least_volume"} <= names
    assert {"crossings_skin_skull", "crossings_muscle_skull", "skull_outside_muscle_wrap"} <= names
    assert report.inverted_tets >= 1 and report.least_volume < 0
    assert report.skull_outside_skin == pytest.approx(1 / len(unit))
    assert report.skull_outside_muscle_wrap == pytest.approx(120 - 92, abs=1.5)


def test_wraps_that_touch_are_no_valid_head():
    _, faces, wraps, bone = parts()
    wraps[1] = wraps[1].copy()
    wraps[1][5] = wraps[2][5]
    report = measured(faces, wraps, bone)
    assert {"least_muscle_thickness", "crossings_muscle_skull", "least_volume"} <= missed(report)
    assert report.least_muscle_thickness == 0
    assert "at least" in report.problems[-1] or "above" in report.problems[-1]


def test_a_wrap_that_crosses_itself_is_found_far_apart_and_around_one_vertex():
    unit, faces, wraps, bone = parts()
    far = wraps[0].copy()
    far[np.argmax(unit[:, 0])] = [-120.0, 0.0, 0.0]
    assert "crossings_within_skin_wrap" in missed(measured(faces, [far, *wraps[1:]], bone))
    # The first of six triangles around a hub is turned over the others, so that it passes through the fourth.
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    fan = np.array([[6, k, (k + 1) % 6] for k in range(6)])
    assert len(fan_crossings(np.vstack([rim, np.zeros(3)]), fan)) == 0
    rim[0], rim[1] = [-0.5, -0.2, 0.4], [-0.5, -0.2, -0.4]
    pairs = fan_crossings(np.vstack([rim, np.zeros(3)]), fan)
    assert [0, 3] in np.sort(pairs, axis=1).tolist()


def test_thin_layers_few_bones_and_a_wrap_off_the_skin_are_missed_each_alone():
    unit, faces, wraps, bone = parts(2)
    assert "least_thickness" in missed(measured(faces, [unit * 100, unit * 99.9, unit * 99.85], bone))
    assert missed(measured(faces, wraps, np.zeros_like(bone))) == {"cranium_vertices", "mandible_vertices"}
    off = measured(faces, wraps, bone, skin=1.009 * wraps[0])
    assert missed(off) == {"wrap_to_skin_mean"}
    assert 0.82 < off.wrap_to_skin_mean < 0.9 and off.skin_outside_wrap == 1.0
    inside = measured(faces, wraps, bone, skin=0.991 * wraps[0])
    assert inside.skin_outside_wrap == 0.0 and missed(inside) == {"wrap_to_skin_mean"}


def test_flat_tets_are_told_by_angle_and_aspect():
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tets = np.array([[0, 1, 3, 2]])
    assert aspect_ratios(regular, tets)[0] == pytest.approx(np.sqrt(1.5))
    assert smallest_dihedrals(regular, tets)[0] == pytest.approx(np.degrees(np.arccos(1 / 3)))
    # Right corner of legs 1, 1, h: longest edge √2, smallest height h / √(1 + 2 h²).
    h = 0.01
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, h]])
    assert aspect_ratios(flat, np.array([[0, 1, 2, 3]]))[0] == pytest.approx(np.sqrt(2) * np.sqrt(1 + 2 * h * h) / h)
    assert aspect_ratios(flat * [1, 1, 0], np.array([[0, 1, 2, 3]]))[0] > 1e20


def _pocketed(depth):
    """A sphere with two sockets and a mouth on its front, each `depth` deep, and their regions."""
    unit, faces, wraps, bone = parts(5)
    regions, wrap = {"eyes": np.zeros(len(unit), bool)}, wraps[0].copy()
    for name, place, size in (
        ("eyes", (0.35, 0.2, 1), 0.12),
        ("eyes", (-0.35, 0.2, 1), 0.12),
        ("mouth", (0, -0.3, 1), 0.12),
    ):
        centre = np.array(place) / np.linalg.norm(place)
        away = np.linalg.norm(unit - centre, axis=1)
        pocket = away < size
        wrap[pocket] -= depth * (1 - (away[pocket, None] / size) ** 2) * centre
        regions[name] = regions.get(name, False) | pocket
        if name == "mouth":
            regions["lips"] = (away >= size) & (away < 1.5 * size)
    return wrap, faces, regions


def test_a_bridged_opening_is_told_from_a_pocket():
    wrap, faces, regions = _pocketed(depth=60.0)
    open_way, open_detour = lid_path(wrap, faces, regions)
    open_lips = lip_path(wrap, faces, regions)
    wrap, faces, regions = _pocketed(depth=0.0)
    shut_way, shut_detour = lid_path(wrap, faces, regions)
    assert shut_detour < 1.2 < 1.4 < open_detour and shut_way < open_way
    assert lip_path(wrap, faces, regions) < open_lips
    nothing = {name: np.zeros_like(mask) for name, mask in regions.items()}
    assert lid_path(wrap, faces, nothing) == (0.0, 0.0) and lip_path(wrap, faces, nothing) == 0.0


def test_an_open_skin_has_the_figures_of_the_closed_one():
    _, faces, wraps, bone = parts(1)
    surfaces = [Surface(x, faces) for x in wraps]
    whole = check_layers(surfaces[0], surfaces, bone, {})
    opened = check_layers(Surface(wraps[0], faces[1:]), surfaces, bone, {})
    assert opened.skull_outside_skin == whole.skull_outside_skin == 0 and opened.problems == whole.problems


@pytest.mark.parametrize(
    ("direction", "right", "wrong"),
    [
        ("at least", (2.0, 3.0), (1.9,)),
        ("at most", (2.0, 1.0), (2.1,)),
        ("above", (2.1,), (2.0,)),
        ("below", (1.9,), (2.0,)),
    ],
)
def test_a_gate_is_missed_on_the_wrong_side_and_by_nan(direction, right, wrong):
    assert not any(Figure("x", value, "mm", direction, 2.0).missed for value in right)
    assert all(Figure("x", value, "mm", direction, 2.0).missed for value in (*wrong, float("nan")))
    assert not Figure("x", None, "mm", direction, 2.0).missed and not Figure("x", 9.0, "mm", None, None).missed
    assert str(Figure("a_b", wrong[0], "mm", direction, 2.0)) == f"a b: {wrong[0]:.4g} mm ({direction} 2 mm)"


def test_check_prints_every_gate(tmp_path, sphere_head, command):
    path = tmp_path / "head.npz"
    save_head(path, sphere_head)
    ended = command("head", "check", path)
    assert ended.status == 0 and ended.errors == []
    lines = ended.out.splitlines()
    assert sum(line.startswith("ok ") for line in lines) == len(check_head(sphere_head).gates)
    assert "ok     least thickness: 15 mm (at least 0.2 mm)" in lines
    as_json = json.loads(command("head", "check", path, "--json").out)
    assert as_json["problems"] == [] and all(gate["passed"] for gate in as_json["gates"])


def test_a_coarse_wrap_has_bounds_of_its_own():
    """0.6 mm off the skin is too far for 10,242 vertices, and not for 642."""
    outcome = []
    for subdivisions in (3, 5):
        _, faces, wraps, bone = parts(subdivisions)
        outcome.append("wrap_to_skin_mean" in missed(measured(faces, wraps, bone, skin=1.006 * wraps[0])))
    assert outcome == [False, True]


def test_lip_and_lid_gates_do_not_depend_on_the_orientation(template):
    wrap, regions = template.skin_wrap, template.regions
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    turned = wrap.vertices @ turn.T + [3.0, 4, 5]
    lids, there = (lid_path(x, wrap.triangles, regions) for x in (wrap.vertices, turned))
    assert lids == pytest.approx(there)
    assert lip_path(wrap.vertices, wrap.triangles, regions) == pytest.approx(lip_path(turned, wrap.triangles, regions))


def test_tets_that_an_open_jaw_inverts_are_counted_and_gated(template, monkeypatch):
    from softdeca.reference.face import check

    head = fit_head(template, template.skin)
    jaw, blink = check.check_posed_head(head)
    assert 0 <= jaw.value < 20 and 0 <= blink.value < 20 and not jaw.missed and not blink.missed
    # A jaw that opens twice as wide tears through the neck.
    deltas = np.array(head.rig.deltas)
    deltas[ARKIT.index("jawOpen")] *= 2.2
    wide = replace(head, rig=replace(head.rig, deltas=deltas))
    assert check.check_posed_head(wide)[0].value > jaw.value
    monkeypatch.setattr("softdeca.lhm.head.gates.INVERTED", check.check_posed_head(wide)[0].value - 1)
    assert check.check_posed_head(wide)[0].missed
    assert check.check_posed_head(template.head) == ()
