"""Whether the forms of a law of one's own agree: energy, derivatives by hand, densities in UFL, moduli at rest.

An isotropic energy is a function of the stretches s, with I1 = s1² + s2² + s3², I2 = s1² s2² + s2² s3² + s3² s1² and
J = s1 s2 s3. Derivatives by three stretches that differ determine those by the three invariants. Derivatives by hand
are compared with differences of fourth order, densities in UFL with the energy, at F of any rotation.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from ...lhm.base.checks import array_of_kind
from ...lhm.base.errors import InputError, quote
from ...lhm.base.mesh import Floats
from .material import EnergyLaw, HasMixedDensity

RANGES = (0.05, 0.4)
"""The largest |ln s| of the samples near rest, where a law must hold, and far from it."""
SAMPLES = 12
"""Of each range, and as many of J = 1."""
STEPS = 1e-4, 2e-4
"""Of a stretch, for differences; how far those of the two are apart tells their error."""
ALLOWED = 1e-6
"""Error of a derivative or an energy, relative to its size and the law's stiffness."""
BY_UFL = 5
"""Every so many samples of these are evaluated in UFL, some milliseconds each."""
NAMES = ("I1", "I2", "J")


def check_law(name: str, law: EnergyLaw):
    """Raise InputError, with the figures, for a law whose forms do not agree.

    psi must be finite near rest and 0 there, free of stress, of the moduli that `lame` says; `by_invariants` must give
    its gradient and Hessian, and infinity where the law does not hold; densities in UFL must be equal to it.
    """
    _check_parameters(name, law)
    rest = np.ones((1, 3))
    near, far = (_sample(largest, seed) for seed, largest in enumerate(RANGES))
    inverted = far * [1.0, 1.0, -1.0]
    stiffness = law.stiffness
    psi = {part: _evaluate(name, law, s)[0] for part, s in (("rest", rest), ("near", near), ("turned", inverted))}
    for s, values in ((rest, psi["rest"]), (near, psi["near"]), *([(inverted, psi["turned"])] * law.finite_inverted)):
        if not np.isfinite(values).all():
            where = _quote_gradient(s[~np.isfinite(values)][0])
            raise InputError(
                f"law {name!r}: psi is {values[~np.isfinite(values)][0]:g} kPa at {where}, where it must hold"
            )
    if not law.finite_inverted and not np.isposinf(psi["turned"]).all():
        which = np.argmin(np.isposinf(psi["turned"]))
        raise InputError(
            f"law {name!r}: psi is {psi['turned'][which]:.6g} kPa at {_quote_gradient(inverted[which])}, expected "
            "infinity: finite_inverted is False"
        )
    if abs(psi["rest"][0]) > ALLOWED * stiffness:
        raise InputError(f"law {name!r}: psi is {psi['rest'][0]:.6g} kPa at rest, expected 0")
    samples = np.concatenate([near, far, inverted] if law.finite_inverted else [near, far])
    _check_derivatives(name, law, samples)
    _check_rest(name, law)
    if importlib.util.find_spec("ufl") is not None:
        _check_densities(name, law, np.concatenate([rest, near, far, inverted])[::BY_UFL])


def _check_parameters(name: str, law: EnergyLaw):
    """Raise InputError for parameters that are no fields, or that may change after a scene is prepared."""
    loose = sorted(set(vars(law)) - {field.name for field in fields(law)})
    if loose:
        raise InputError(f"law {name!r}: {loose[0]} is no field of a frozen dataclass, so solvers do not see its value")
    try:
        hash(law)
    except TypeError as error:
        raise InputError(f"law {name!r}: its parameters may change ({error}); expected numbers") from None


def _sample(largest: float, seed: int) -> Floats:
    """Draw stretches, shape (n, 3), the second half of them of J = 1."""
    logs = np.random.default_rng(seed).uniform(-largest, largest, (2 * SAMPLES, 3))
    logs[SAMPLES:] -= logs[SAMPLES:].mean(axis=1, keepdims=True)
    return np.exp(logs)


def invariants(s: Floats) -> tuple[Floats, Floats]:
    """Return I1, I2 and J of stretches (m, 3), shape (3, m), and their derivatives [m, invariant, stretch]."""
    q = s**2
    others = q.sum(axis=1, keepdims=True) - q
    values = np.stack([q.sum(axis=1), 0.5 * np.sum(q * others, axis=1), s.prod(axis=1)])
    return values, np.stack([2 * s, 2 * s * others, s[:, [1, 2, 0]] * s[:, [2, 0, 1]]], axis=1)


def _evaluate(name: str, law: EnergyLaw, s: Floats) -> tuple[Floats, Floats, Floats]:
    """Return psi (m,), gradient (m, 3) and Hessian (m, 3, 3) by invariants at stretches (m, 3)."""
    m = len(s)
    try:
        with np.errstate(all="ignore"):
            found = law.by_invariants(*invariants(s)[0])
        psi, gradient, hessian = (array_of_kind("by_invariants", each, "fiu", "real numbers") for each in found)
        psi, gradient, hessian = (each.astype(np.float64, copy=False) for each in (psi, gradient, hessian))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit would end the process as if all had been done
        raise InputError(f"law {name!r}: by_invariants: {type(error).__name__}: {quote(str(error), 100)}") from error
    if (psi.shape, gradient.shape, hessian.shape) != ((m,), (m, 3), (m, 3, 3)):
        raise InputError(
            f"law {name!r}: by_invariants: expected shapes ({m},), ({m}, 3), ({m}, 3, 3), got {psi.shape}, "
            f"{gradient.shape}, {hessian.shape}"
        )
    if np.isnan(psi).any():
        where = _quote_gradient(s[np.isnan(psi)][0])
        raise InputError(f"law {name!r}: psi is NaN at {where}, expected infinity where the law does not hold")
    return psi, gradient, hessian


def _differentiate(values: Callable[[Floats], Floats], s: Floats) -> tuple[Floats, Floats]:
    """Differentiate values (m, ...) by each stretch, shape (m, ..., 3); also return the error of that, about."""
    found = []
    for size in STEPS:
        columns = []
        for step in size * np.eye(3):
            ahead, behind, further, before = (values(s + k * step) for k in (1.0, -1.0, 2.0, -2.0))
            columns.append((8.0 * (ahead - behind) - (further - before)) / (12.0 * size))
        found.append(np.stack(columns, axis=-1))
    return found[0], np.abs(found[1] - found[0])


def _check_rest(name: str, law: EnergyLaw):
    rest = np.ones((1, 3))

    def stress(s: Floats) -> Floats:
        return np.einsum("mk,mki->mi", _evaluate(name, law, s)[1], invariants(s)[1])

    if (at_rest := np.abs(stress(rest)).max()) > ALLOWED * law.stiffness:
        raise InputError(f"law {name!r}: its stress is {at_rest:.6g} kPa at rest, expected 0")
    slope = _differentiate(stress, rest)[0][0]
    moduli = (slope[0, 0] - slope[0, 1]) / 2, slope[0, 1]
    if np.abs(np.subtract(moduli, law.lame)).max() > ALLOWED * law.stiffness:
        says, are = (" and ".join(f"{value:.6g}" for value in pair) for pair in (law.lame, moduli))
        raise InputError(f"law {name!r}: mu and lmbda at rest: expected {says} kPa, by `lame`, got {are}")


def _check_derivatives(name: str, law: EnergyLaw, s: Floats):
    """Compare gradient and Hessian with differences of psi and of the gradient, where all of these are finite."""
    with np.errstate(all="ignore"):
        psi, gradient, hessian = _evaluate(name, law, s)
        by_s = invariants(s)[1]
        stress, stress_error = _differentiate(lambda at: _evaluate(name, law, at)[0], s)
        slope, slope_error = _differentiate(lambda at: _evaluate(name, law, at)[1], s)
    # Each by the stretches, and by the invariants for what is told: x by s = (x by I) (I by s).
    for what, words, got, expected, doubt in (
        ("dpsi", "psi", gradient[:, None], stress[:, None], stress_error[:, None]),
        ("d²psi", "the gradient", hessian, slope, slope_error),
    ):
        holds = np.isfinite(psi) & np.isfinite(expected).all(axis=(1, 2))
        found = np.einsum("mkl,mli->mki", got, by_s)
        size = law.stiffness + np.abs(np.where(holds[:, None, None], expected, 0.0)).max(axis=(1, 2))
        error = np.where(holds, (np.abs(found - expected) - doubt).max(axis=(1, 2)) / size, 0.0)
        error = np.where(np.isnan(error), np.inf, error)
        if error.max() <= ALLOWED:
            continue
        m = error.argmax()
        right = np.linalg.solve(by_s[m].T, expected[m].T).T
        k, i = np.unravel_index(np.argmax(np.nan_to_num(np.abs(got[m] - right), nan=np.inf)), right.shape)
        of = f"d{NAMES[i]}" if what == "dpsi" else f"d{NAMES[k]} d{NAMES[i]}"
        raise InputError(
            f"law {name!r}: by_invariants: {what}/{of} at {_quote_gradient(s[m])}: expected {right[k, i]:.6g} kPa, by "
            f"differences of {words}, got {got[m, k, i]:.6g}"
        )


def _check_densities(name: str, law: EnergyLaw, s: Floats):
    """Compare densities in UFL with psi at stretches (m, 3), turned at random."""
    turns = Rotation.random(2 * len(s), random_state=0).as_matrix().reshape(2, -1, 3, 3)
    F = turns[0] @ (s[:, :, None] * turns[1])
    psi = _evaluate(name, law, s)[0]
    for at, expected, stretches in zip(F, psi, s, strict=True):
        _compare(name, "density", lambda F: law.density(F, law), at, expected, stretches, law.stiffness)
    if not isinstance(law, HasMixedDensity):
        return
    law.check_mixed()

    def mixed(pressure: float, F: Any) -> Any:
        return law.mixed_density(F, pressure, law)

    upright = np.flatnonzero(np.isfinite(psi) & (s.prod(axis=1) > 0))
    kept = _evaluate(name, law, s / np.cbrt(s.prod(axis=1, keepdims=True)))[0]
    for m in upright[::BY_UFL]:
        _compare(name, "isochoric", lambda F: law.isochoric(F, law), F[m], kept[m], s[m], law.stiffness)

        def lost(pressure: float, F: Floats = F[m]) -> float:
            return -_in_ufl(partial(mixed, pressure), F)

        try:
            pressure = minimize_scalar(lost, (-law.stiffness, law.stiffness), options={"maxiter": 40}).x
        except (Exception, SystemExit) as error:
            raise InputError(
                f"law {name!r}: mixed_density: {type(error).__name__}: {quote(str(error), 100)}"
            ) from error
        form = f"mixed_density, greatest at a pressure of {pressure:.6g} kPa,"
        _compare(name, form, partial(mixed, pressure), F[m], psi[m], s[m], law.stiffness)


def _compare(
    name: str, form: str, density: Callable[[Any], Any], F: Floats, expected: float, s: Floats, stiffness: float
):
    """Raise InputError for a density in UFL [kPa] that is not the one expected at F (3, 3), of stretches (3,)."""
    try:
        found = _in_ufl(density, F)
    except (Exception, SystemExit) as error:
        if not np.isfinite(expected):  # as the logarithm of a number below 0
            return
        raise InputError(
            f"law {name!r}: {form} at {_quote_gradient(s)}: {type(error).__name__}: {quote(str(error), 100)}"
        ) from error
    if np.isfinite(found) != np.isfinite(expected) or (
        np.isfinite(expected) and abs(found - expected) > ALLOWED * (1e-3 * stiffness + abs(expected))
    ):
        raise InputError(
            f"law {name!r}: {form} at {_quote_gradient(s)}: expected {expected:.6g} kPa, by psi, got {found:.6g}"
        )


def _in_ufl(density: Callable[[Any], Any], F: Floats) -> float:
    """Evaluate a density in UFL [kPa] at F (3, 3); NaN where it is no real number."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import ufl
        from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    value = apply_algebra_lowering(ufl.as_ufl(density(ufl.as_matrix(F.tolist()))))(())
    return float("nan") if isinstance(value, complex) else float(value)


def _quote_gradient(s: Floats) -> str:
    return f"F = diag({', '.join(f'{each:.6g}' for each in s)})"
