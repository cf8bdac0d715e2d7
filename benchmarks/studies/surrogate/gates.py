"""Bounds of the surrogate's share of |T - carried(S)| for each kind of p, which no trivial rival meets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ....surrogate.methods import CARRIED, DERIVATIVES, HYPERNETWORK, NETWORK, NETWORK_AND_DERIVATIVES, SETTLED
from ....surrogate.ruler import DEFAULT, KINDS
from ...harness.study import at_most
from .scores import ALL, UNSCALED, Line

TRIVIAL = CARRIED, SETTLED
"""Rivals without learning, of which no one gives derivatives: nothing may lose to them."""
BOUNDS: Mapping[str, float] = {
    ALL: 0.197,
    "materials": 0.188,
    "bones": 0.178,
    "palsy": 0.135,
    "several": 0.22,
    UNSCALED: 0.147,
}
"""Largest share of a network, on the corpus of `make study`: at most a quarter above what it measured there, and
below the share of each trivial rival. Kinds in which the network loses have no bound; `defeats` names them."""
ADDED = 0.95
"""Largest share of network + derivatives over that of the derivatives alone, to which the network adds.

Derivatives at rest know of no contact, which the corpus has, and the network has learned little of it.
"""


def make_gates(scores: Iterable[Line]) -> list[dict]:
    """Bound both networks' shares by kind, and that of network + derivatives over the derivatives'."""
    shares = find_shares(scores)
    kinds = {kind for _, kind in shares} | {ALL}
    both, derivatives = shares.get((NETWORK_AND_DERIVATIVES, ALL)), shares.get((DERIVATIVES, ALL))
    ratio = None if both is None or derivatives is None else both / derivatives
    return [
        *(
            at_most(f"{name}'s share of |T - carried(S)|, {kind}", shares.get((name, kind)), bound)
            for name in (NETWORK, HYPERNETWORK)
            for kind, bound in BOUNDS.items()
            if kind in kinds
        ),
        at_most("share of network + derivatives over the derivatives'", ratio, ADDED),
    ]


def find_shares(scores: Iterable[Line]) -> dict[tuple[str, str], float]:
    """Find the share by method and kind."""
    return {(score["method"], score["kind"]): score["share"] for score in scores}


def describe_defeats(scores: Iterable[Line]) -> str:
    """Say on which kinds a network loses to a trivial rival; empty where none does."""
    shares = find_shares(scores)
    lost = [
        f"{kind}: {name} {100 * shares[name, kind]:.1f} %, {rival} {100 * shares[rival, kind]:.1f} %"
        for name in (NETWORK, HYPERNETWORK)
        for kind in (ALL, *KINDS)
        for rival in TRIVIAL
        if kind != DEFAULT and (name, kind) in shares and (rival, kind) in shares
        and shares[rival, kind] <= shares[name, kind]
    ]  # fmt: skip
    return f"A network loses to a rival without learning on: {'; '.join(lost)}." if lost else ""
