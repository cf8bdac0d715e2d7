"""Whether the formula of a law of one's own is an energy that solvers can take: finite, at rest, of its moduli.

An isotropic energy is a function of the stretches s, with I1 = s1² + s2² + s3², I2 = s1² s2² + s2² s3² + s3² s1² and
J = s1 s2 s3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
from scipy.optimize import minimize_scalar

from ...lhm.base.errors import InputError, quote
from ...lhm.base.mesh import Floats
from .material import EnergyLaw, MixedLaw

RANGES = (0.05, 0.4)
"""The largest |ln s| of the samples near rest, where a law must hold, and far from it."""
SAMPLES = 12
"""Samples of each range, and as many with J = 1."""
STEP = 1e-4
"""Step of a stretch in differences of fourth order."""
ALLOWED = 1e-6
"""Error of a derivative or an energy, relative to its size and the law's stiffness."""


def check_law(name: str, law: EnergyLaw):
    """Raise InputError, with the figures, for a law that is no energy of its moduli.

    psi must be finite near rest and 0 there, free of stress, of the moduli that `lame` says, and infinite or no number
    where the law does not hold. Its formula must be differentiable by complex steps; a mixed density must give it back.
    """
    _check_parameters(name, law)
    rest = np.ones((1, 3))
    near, far = (_sample(largest, seed) for seed, largest in enumerate(RANGES))
    inverted = far * [1.0, 1.0, -1.0]
    stiffness = law.stiffness
    for s in (rest, near, *([inverted] * law.finite_inverted)):
        psi = _evaluate(name, law, s)
        if not np.isfinite(psi).all():
            where = _quote_gradient(s[~np.isfinite(psi)][0])
            raise InputError(f"law {name!r}: psi is not finite at {where}, where it must hold")
    turned = _evaluate(name, law, inverted)
    if not law.finite_inverted and np.isfinite(turned).any():
        which = np.argmax(np.isfinite(turned))
        raise InputError(
            f"law {name!r}: psi is {turned[which]:.6g} kPa at {_quote_gradient(inverted[which])}, expected infinity: "
            "finite_inverted is False"
        )
    if abs(at_rest := _evaluate(name, law, rest)[0]) > ALLOWED * stiffness:
        raise InputError(f"law {name!r}: psi is {at_rest:.6g} kPa at rest, expected 0")
    samples = np.concatenate([near, far, inverted] if law.finite_inverted else [near, far])
    _check_slopes(name, law, samples[np.isfinite(_evaluate(name, law, samples))])
    _check_rest(name, law)
    if isinstance(law, MixedLaw):
        _check_mixed(name, law, far)


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


def _evaluate(name: str, law: EnergyLaw, s: Floats, of: Callable[[EnergyLaw, Floats], Floats] = EnergyLaw.energy):
    """Return psi (m,), or what else `of` a law gives, at stretches (m, 3)."""
    try:
        found = np.asarray(of(law, invariants(s)[0]), dtype=np.float64)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit would end the process as if all had been done
        raise InputError(f"law {name!r}: density: {type(error).__name__}: {quote(str(error), 100)}") from error
    if found.shape[-1:] != (len(s),):
        raise InputError(f"law {name!r}: density: expected shape ({len(s)},), got {found.shape}")
    return found


def _differentiate(values: Callable[[Floats], Floats], s: Floats) -> Floats:
    """Differentiate values (m, ...) by each stretch, shape (m, ..., 3)."""
    columns = []
    for step in STEP * np.eye(3):
        ahead, behind, further, before = (values(s + k * step) for k in (1.0, -1.0, 2.0, -2.0))
        columns.append((8.0 * (ahead - behind) - (further - before)) / (12.0 * STEP))
    return np.stack(columns, axis=-1)


def _stress(name: str, law: EnergyLaw, s: Floats) -> Floats:
    """Return psi's derivatives by stretches, shape (m, 3)."""
    return np.einsum("km,mki->mi", _evaluate(name, law, s, EnergyLaw.slopes), invariants(s)[1])


def _check_slopes(name: str, law: EnergyLaw, s: Floats):
    """Compare derivatives by complex steps with differences of psi: a formula with `abs` has none by the former."""
    found, expected = _stress(name, law, s), _differentiate(lambda at: _evaluate(name, law, at), s)
    size = law.stiffness + np.abs(expected).max(axis=1)
    error = np.nan_to_num(np.abs(found - expected).max(axis=1) / size, nan=np.inf)
    if error.max() > ALLOWED:
        m = error.argmax()
        i = np.abs(found - expected)[m].argmax()
        raise InputError(
            f"law {name!r}: dpsi/ds{i + 1} at {_quote_gradient(s[m])}: expected {expected[m, i]:.6g} kPa, by "
            f"differences, got {found[m, i]:.6g} by complex steps"
        )


def _check_rest(name: str, law: EnergyLaw):
    rest = np.ones((1, 3))
    if (at_rest := np.abs(_stress(name, law, rest)).max()) > ALLOWED * law.stiffness:
        raise InputError(f"law {name!r}: its stress is {at_rest:.6g} kPa at rest, expected 0")
    slope = _differentiate(lambda s: _stress(name, law, s), rest)[0]
    moduli = (slope[0, 0] - slope[0, 1]) / 2, slope[0, 1]
    if np.abs(np.subtract(moduli, law.lame)).max() > ALLOWED * law.stiffness:
        says, are = (" and ".join(f"{value:.6g}" for value in pair) for pair in (law.lame, moduli))
        raise InputError(f"law {name!r}: mu and lmbda at rest: expected {says} kPa, by `lame`, got {are}")


def _check_mixed(name: str, law: MixedLaw, s: Floats):
    """Compare the mixed density, greatest in the pressure, with psi at stretches (m, 3)."""
    law.check_mixed()
    psi = _evaluate(name, law, s)
    for m in np.flatnonzero(np.isfinite(psi)):
        I1, I2, J = invariants(s[m : m + 1])[0][:, 0]

        def lost(pressure: float, at: tuple[float, float, float] = (I1, I2, J)) -> float:
            return -float(law.mixed_density(*at, pressure, law, np))

        found = minimize_scalar(lost, (-law.stiffness, law.stiffness), options={"maxiter": 40})
        if not abs(found.fun + psi[m]) <= ALLOWED * (1e-3 * law.stiffness + abs(psi[m])):
            raise InputError(
                f"law {name!r}: mixed_density, greatest at a pressure of {found.x:.6g} kPa, at "
                f"{_quote_gradient(s[m])}: expected {psi[m]:.6g} kPa, by density, got {-found.fun:.6g}"
            )


def _quote_gradient(s: Floats) -> str:
    return f"F = diag({', '.join(f'{each:.6g}' for each in s)})"
