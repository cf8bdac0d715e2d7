"""Marches through time against closed forms, themselves in another frame, and projective dynamics' steps."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.reference import SOLVERS, Face, Reason, Scene, SceneError, prepare, solve, terms
from softdeca.reference.march import Scheme, march
from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems.meshes import box, vertices_at

WAYS = [*((solver, {}) for solver in SOLVERS), ("fenicsx", {"element": "P2"}), ("skfem", {"element": "P2"})]
H, DENSITY = 1 / 60, 1e-6
TISSUE = (terms.Strain(5.0), terms.Volume(67.5))
X, TETS = box((2, 2, 4), (10.0, 10.0, 20.0))
MASSES = terms.Gravity(np.ones(3), DENSITY).lump(Scene(X, TETS, TISSUE), DENSITY)
OMEGA = 2 * np.pi * 4
DOWN = np.array([0.0, 0.0, -9810.0])


def marched(scene, **choices):
    """A march to its end, all of whose steps converge."""
    moments = list(march(scene, **choices))
    assert moments[-1].solution.is_balanced
    return SimpleNamespace(
        moments=moments,
        positions=np.array([moment.positions for moment in moments]),
        velocities=np.array([moment.velocities for moment in moments]),
    )


def swinging(target=None):
    """A block on springs of ω² times each vertex' mass, so that it swings as one."""
    return Scene(
        X, TETS, (*TISSUE, terms.Target(np.arange(len(X)), X if target is None else target, OMEGA**2 * MASSES))
    )


def standing(*more):
    return Scene(X, TETS, (*TISSUE, terms.Fixed(vertices_at(X, 2, 0.0)), *more))


def poles(x):
    """Modulus and angle per step of the swing that x (k,) is: x_n+1 = 2 r cos(a) x_n - r² x_n-1."""
    (last, before), *_ = np.linalg.lstsq(np.column_stack([x[2:-1], x[1:-2]]), x[3:], rcond=None)
    return np.sqrt(-before), np.arccos(last / (2 * np.sqrt(-before)))


@pytest.mark.parametrize(("solver", "options"), WAYS)
def test_free_fall_of_implicit_euler(solver, options):
    """z_n = -g h² n (n + 1)/2, whether weight or the frame's acceleration pulls."""
    scene = Scene(X, TETS, TISSUE)
    n = np.arange(11)
    common = {"time_step": H, "steps": 10, "density": DENSITY, "solver": solver, **options}
    fallen = marched(scene, acceleration=lambda t: -DOWN, **common)
    depth = 9810.0 * H**2 * n * (n + 1) / 2
    assert np.abs(fallen.positions - X + depth[:, None, None] * [0, 0, 1]).max() < 1e-9 * depth[-1]
    if options.get("element") != "P2":  # whose edges carry weight, and no mass
        weight = marched(replace(scene, terms=(*TISSUE, terms.Gravity(DOWN, DENSITY))), **common)
        assert np.abs(weight.positions - fallen.positions).max() < 1e-9 * depth[-1]


@pytest.mark.parametrize("solver", SOLVERS)
def test_amplitude_and_angle_of_an_oscillator(solver):
    """Implicit Euler: 1/√(1 + (ωh)²), atan(ωh); Newmark: no loss, 2 atan(ωh/2), which is late by (ωh)²/12."""
    kick = np.tile([100.0, 0.0, 0.0], (len(X), 1))
    found = {}
    for name in ("implicit Euler", "Newmark"):
        run = marched(
            swinging(), time_step=H, steps=40, density=DENSITY, scheme=name, velocities=kick, tolerance=1e-11,
            solver=solver,
        )  # fmt: skip
        found[name] = poles((run.positions - X).mean(axis=1)[:, 0])
    angle = OMEGA * H
    assert found["implicit Euler"] == (
        pytest.approx(1 / np.sqrt(1 + angle**2), rel=1e-9),
        pytest.approx(np.arctan(angle), rel=1e-9),
    )
    assert found["Newmark"] == (pytest.approx(1, abs=1e-9), pytest.approx(2 * np.arctan(angle / 2), rel=1e-9))
    assert found["Newmark"][1] / angle == pytest.approx(1 - angle**2 / 12, abs=angle**4 / 60)


def test_generalised_alpha_damps_what_it_does_not_resolve_by_its_radius():
    """At ωh -> ∞ the poles' modulus is the radius; a step is (ωh)² = 4e6 here."""
    stiff = replace(swinging(), terms=(*TISSUE, terms.Target(np.arange(len(X)), X, (2e3 / H) ** 2 * MASSES)))
    kick = np.tile([100.0, 0.0, 0.0], (len(X), 1))
    for radius in (0.5, 0.8):
        run = marched(
            stiff, time_step=H, steps=16, density=DENSITY, velocities=kick, tolerance=1e-12,
            scheme=Scheme.from_name("generalised-alpha", spectral_radius=radius),
        )  # fmt: skip
        v = np.abs(run.velocities.mean(axis=1)[:, 0])
        # A double pole: n radius^n; the ratio of successive values tends to the radius like 1/n.
        assert (v[16] / 16) / (v[12] / 12) == pytest.approx(radius**4, rel=0.12)


ORDERS = {"implicit Euler": 1, "Newmark": 2, "generalised-alpha": 2}


@pytest.mark.parametrize(
    ("name", "solver"),
    [*((name, solver) for name in ORDERS for solver in ("projective", "fenicsx")), ("Newmark", "skfem")],
)
def test_order_on_springs_whose_ends_move(name, solver):
    """Ends that move by A sin(Ωt) swing the block by A ω²/(ω² - Ω²) (sin Ωt - Ω/ω sin ωt) from rest."""
    amplitude, pace, end = 2.0, 0.6 * OMEGA, 0.2
    exact = amplitude * OMEGA**2 / (OMEGA**2 - pace**2) * (np.sin(pace * end) - pace / OMEGA * np.sin(OMEGA * end))

    def ends(t):
        return X + amplitude * np.sin(pace * t) * np.array([1.0, 0, 0])

    errors = []
    for steps in (16, 32) if solver == "skfem" else (32, 64, 128):  # it is slow
        run = marched(
            swinging(), time_step=end / steps, steps=steps, density=DENSITY, scheme=name, solver=solver,
            scenes=lambda t: swinging().with_targets(ends(t)),
        )  # fmt: skip
        errors.append(abs(run.positions[-1, 0, 0] - X[0, 0] - exact))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(ORDERS[name], abs=0.2)


def test_scenes_by_time_differ_in_what_may_vary():
    with pytest.raises(SceneError, match="Strain.stiffness differs"):
        marched(
            standing(), time_step=H, steps=4, density=DENSITY,
            scenes=lambda t: replace(standing(), terms=(terms.Strain(5 + t), *standing().terms[1:])),
        )  # fmt: skip


def bar(stiffness=8.0):
    """Strain alone is a bar without lateral contraction: Young's modulus is its stiffness, and waves run at √(E/ρ)."""
    vertices, tets = box((1, 1, 10), (4.0, 4.0, 40.0))
    return Scene(vertices, tets, (terms.Strain(stiffness), terms.Fixed(vertices_at(vertices, 2, 0.0))))


def ringing(**choices):
    """The bar's first mode, its period by theory [s] and the part of its motion that the mode's shape has."""
    scene = bar()
    period = 4 * 40.0 / np.sqrt(8.0 / DENSITY)
    shape = np.sin(np.pi * scene.vertices[:, 2] / 80.0)
    start = scene.vertices + 1e-3 * shape[:, None] * [0, 0, 1]
    run = marched(
        scene, time_step=period / 80, steps=160, scheme="Newmark", density=DENSITY, positions=start, **choices
    )
    return (run.positions - scene.vertices)[:, :, 2] @ shape, 2 * np.pi / 80


def test_damping_ratio_by_logarithmic_decrement():
    """ζ = c/(2ω), here 0.05, of the bar's first mode."""
    omega = 2 * np.pi * np.sqrt(8.0 / DENSITY) / 160.0
    x, _ = ringing(damping=0.1 * omega)
    modulus, angle = poles(x)
    assert -np.log(modulus) / np.hypot(np.log(modulus), angle) == pytest.approx(0.05, rel=5e-3)


@pytest.mark.parametrize("name", ["implicit Euler", "Newmark", "generalised-alpha"])
@pytest.mark.parametrize(
    ("solver", "options"), [("fenicsx", {"element": "P1"}), ("fenicsx", {"element": "P2"}), ("skfem", {})]
)
def test_a_free_body_keeps_its_momentum(name, solver, options):
    """Linear momentum in every step, whatever the body does within."""
    v = np.random.default_rng(0).normal(size=X.shape) * 50.0 + [30.0, -20.0, 10.0]
    scene = Scene(X, TETS, (terms.Hyperelastic(NeoHookean(mu=2.5, lmbda=20.0)),))
    run = marched(
        scene, time_step=1 / 240, steps=12, density=DENSITY, scheme=name, velocities=v, tolerance=1e-11, solver=solver,
        **options,
    )  # fmt: skip
    momentum = (MASSES[:, None] * run.velocities).sum(axis=1)
    assert np.abs(run.positions - X).max() > 1.0
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * np.abs(momentum[0]).max()


def kinetic_energies(run):
    return 0.5 * np.einsum("i,tic->t", MASSES, run.velocities**2)


@pytest.mark.parametrize("name", ["implicit Euler", "generalised-alpha"])
def test_energy_does_not_grow_without_input(name):
    """A bent column that is let go; implicit Euler loses in every step, generalised-alpha over the motion."""
    bent = solve(standing(terms.Gravity([9810.0, 0, 0], DENSITY)), solver="fenicsx").positions
    run = marched(standing(), time_step=1 / 240, steps=60, density=DENSITY, scheme=name, positions=bent)
    kinetic, potential = kinetic_energies(run), np.array([moment.energy for moment in run.moments])
    balance = kinetic + potential - potential[0]
    assert kinetic.max() > 0.2 * potential[0]
    assert balance.max() < 1e-3 * potential[0]
    assert balance[-1] < 0
    if name == "implicit Euler":
        assert np.diff(balance).max() < 1e-9 * potential[0]


def test_newmark_loses_nothing_of_what_goes_in_and_what_dampers_take():
    """The balance of quadratic energies is exact: springs with moving ends, an accelerated frame, a damper."""
    springs = swinging()

    def ends(t):
        return X + 3.0 * np.sin(10 * t) * np.array([1.0, 0.0, 0.5])

    def shaken(t):
        return np.array([0.0, 500.0 * np.cos(8 * t), 0.0])

    run = marched(
        springs, time_step=H, steps=40, density=DENSITY, scheme="Newmark", damping=3.0, tolerance=1e-11,
        scenes=lambda t: springs.with_targets(ends(t)), acceleration=shaken,
    )  # fmt: skip
    potential = np.array([moment.energy for moment in run.moments])
    time = H * np.arange(41)
    frame, places = np.array([shaken(t) for t in time]), np.array([ends(t) for t in time])

    def means(values):
        return 0.5 * (values[1:] + values[:-1])

    dissipated = 3.0 * H * np.einsum("i,tic->t", MASSES, means(run.velocities) ** 2)
    put_in = -np.einsum("i,tic,tc->t", MASSES, np.diff(run.positions, axis=0), means(frame))
    away = means(run.positions - places)
    put_in -= np.einsum("i,tic,tic->t", OMEGA**2 * MASSES, away, np.diff(places, axis=0))
    change = np.diff(kinetic_energies(run) + potential)
    assert dissipated.sum() > 0.1 * potential.max()
    assert np.abs(np.cumsum(change + dissipated - put_in)).max() < 1e-8 * np.abs(np.cumsum(put_in)).max()


def test_a_shaken_head_is_the_same_seen_from_outside():
    """Held vertices moved by s_n are those of a frame of acceleration (s_n+1 - 2 s_n + s_n-1)/h², for Euler exactly."""
    s = 4.0 * np.sin(20 * H * np.arange(-1, 9))[:, None] * [1.0, 0.3, 0.0]
    scene = standing()
    (held,) = scene.of(terms.Fixed)
    places = X[held.vertices]
    rest = {"positions": X + s[1], "velocities": np.tile((s[1] - s[0]) / H, (len(X), 1))}
    outside = marched(
        scene,
        time_step=H,
        steps=8,
        density=DENSITY,
        scenes=lambda t: scene.with_fixed(places + s[1 + round(t / H)]),
        tolerance=1e-11,
        **rest,
    )
    shaking = (s[2:] - 2 * s[1:-1] + s[:-2]) / H**2
    inside = marched(
        scene, time_step=H, steps=8, density=DENSITY, tolerance=1e-11,
        acceleration=lambda t: shaking[max(round(t / H) - 1, 0)],
    )  # fmt: skip
    assert np.abs(inside.positions - X).max() > 0.02
    assert np.abs(outside.positions - s[1:, None] - inside.positions).max() < 1e-8


def test_mass_of_the_skin_alone_is_springs_of_projective_dynamics(sphere_head):
    """Massless tissue follows in balance: springs m/h² at the skin, as SoftDECA's Eq. 9 has them."""
    from softdeca.reference import Parameters
    from softdeca.reference.face.facial import facial_scene

    S = sphere_head.skin.vertices
    scene = facial_scene(sphere_head, Parameters(), S, bones="prescribed")
    wrap, n, areal = sphere_head.skin_wrap, len(S), 4e-6
    pulled = S + 4.0 * np.exp(-np.sum((S - S[5]) ** 2, axis=1) / 2e3)[:, None] * [1.0, 0, 0]
    start = solve(scene.with_targets(pulled), solver="fenicsx", tolerance=1e-10).positions
    run = marched(
        scene, time_step=H, steps=4, skin=wrap.triangles, skin_density=areal, positions=start, tolerance=1e-10
    )
    springs = terms.Target(np.arange(n), S, areal * wrap.vertex_areas / H**2)
    prepared = prepare(replace(scene, terms=(*scene.terms, springs)))
    x, v = start, np.zeros_like(start)
    for found in run.positions[1:]:
        step = replace(springs, positions=(x + H * v)[:n])
        after = prepared.solve(replace(scene, terms=(*scene.terms, step)), start=x, tolerance=1e-10).positions
        x, v = after, (after - x) / H
        assert np.abs(x - found).max() < 1e-6 * np.abs(start - scene.vertices).max()


def test_a_long_step_is_statics():
    scene = standing(terms.Gravity(DOWN, DENSITY))
    static = solve(scene, solver="fenicsx", tolerance=1e-10).positions
    run = marched(scene, time_step=1e3, steps=2, density=DENSITY)
    assert np.abs(run.positions[1:] - static).max() < 1e-6 * np.abs(static - X).max()


def test_held_vertices_that_leap_take_the_others_along():
    """One step of a quarter of the column's height would invert the tets next to it."""
    scene = replace(standing(), terms=(terms.Hyperelastic(NeoHookean(2.5, 20.0)), *standing().terms[2:]))
    base = X[scene.of(terms.Fixed)[0].vertices]
    run = marched(
        scene,
        time_step=1.0,
        steps=2,
        density=DENSITY,
        scenes=lambda t: scene.with_fixed(base + [0, 0, 6.0]) if t else scene,
    )
    assert np.abs(run.positions[-1] - X - [0, 0, 6.0]).max() < 1e-2


def test_what_a_march_gives_is_a_copy_and_what_it_is_given_a_scene():
    """A caller who centres positions in place changes no later step."""
    options = {"time_step": H, "steps": 4, "density": DENSITY, "solver": "projective"}
    kick = np.tile([100.0, 0.0, 0.0], (len(X), 1))
    right = marched(swinging(), velocities=kick, **options)
    for number, moment in enumerate(march(swinging(), velocities=kick, **options)):
        np.testing.assert_array_equal(moment.positions, right.positions[number])
        for array in (moment.positions, moment.velocities, moment.accelerations, moment.gradient):
            array -= 7.0
    with pytest.raises(SceneError, match="scenes: expected a Scene at 0.0?1?[0-9]* s, got NoneType"):
        list(march(swinging(), scenes=lambda t: swinging() if t == 0.0 else None, **options))
    for one in ({"skin_density": 1e-6}, {"skin": TETS[:, :3]}):
        with pytest.raises(SceneError, match="skin and skin_density need each other"):
            march(swinging(), **one, **options)


def test_a_march_keeps_copies_of_what_it_is_given():
    """Arrays of a caller that writes to them later, as to one buffer for the frame's acceleration at all times."""
    buffer, kick = np.zeros(3), np.tile([100.0, 0.0, 0.0], (len(X), 1))

    def shake(time):
        buffer[0] = 1e5 * time
        return buffer

    options = {"time_step": H, "steps": 3, "density": DENSITY, "solver": "projective", "scheme": "generalised-alpha"}
    right = marched(swinging(), velocities=kick, acceleration=lambda time: shake(time).copy(), **options)
    moments = march(swinging(), velocities=kick, acceleration=shake, **options)
    kick[:] = 0.0
    np.testing.assert_array_equal([moment.positions for moment in moments], right.positions)


def test_a_step_that_fails_ends_the_march():
    """A column let go from a bend needs more than two iterations of its first step."""
    from softdeca.reference.fenicsx.policy import FenicsxPolicy, MinimisePolicy

    bent = X + np.outer((X[:, 2] / 20.0) ** 2, [5.0, 0, 0])
    policy = FenicsxPolicy(minimise=MinimisePolicy(max_iterations=2))
    run = march(standing(), time_step=H, steps=3, density=DENSITY, positions=bent, policy=policy)
    assert [moment.solution.reason for moment in run] == [Reason.CONVERGED, Reason.MAX_ITERATIONS]


def test_coefficients_by_the_spectral_radius():
    """Newmark's are those of generalised-alpha that average nothing; at radius 1 the latter has γ = β·2 = 1/2."""
    plain = Scheme.from_name("Newmark")
    half, one = (Scheme.from_name("generalised-alpha", spectral_radius=r) for r in (0.5, 1.0))
    assert (plain.by_acceleration, plain.to_velocity) == ((0.25, 0.25), (0.5, 0.5))
    assert (half.alpha_m, half.alpha_f) == (0.0, pytest.approx(1 / 3))
    assert half.to_velocity[1] == pytest.approx(5 / 6) and half.by_acceleration[1] == pytest.approx(4 / 9)
    assert (one.alpha_m, one.alpha_f, one.to_velocity[1], one.by_acceleration[1]) == (0.5, 0.5, 0.5, 0.25)


def test_a_shaken_shell_whose_thin_tets_invert_takes_few_iterations(spheres):
    """Newton's exact tangent is tried from a step's beginning on, which is near its end: projected, 19 are needed."""
    face = Face(spheres(1, (100.0, 97.0, 94.0)), choices={"bones": "prescribed", "cells": "tets"})
    areal = float(np.mean(face.parameters.target_stiffness)) / (2 * np.pi * face.parameters.frequency) ** 2
    pace = 2 * np.pi * 2

    def shaken(t):
        return np.array([-60.0 * pace**2 * np.sin(pace * t), 0.0, 0.0])

    moments = march(
        face.neutral_scene(), time_step=1 / 120, steps=16, scheme="Newmark", skin=face.head.skin_wrap.triangles,
        skin_density=areal, acceleration=shaken, tolerance=1e-6,
    )  # fmt: skip
    solutions = [moment.solution for moment in moments][1:]
    assert len(solutions) == 16 and all(each.converged and each.iterations <= 10 for each in solutions)
