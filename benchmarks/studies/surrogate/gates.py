"""Bounds of the surrogate's share of |T - carried(S)| for each kind of p, which no trivial rival meets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ....surrogate.methods import CARRIED, DERIVATIVES, NETWORK, NETWORK_AND_DERIVATIVES, SETTLED
from ....surrogate.ruler import DEFAULT, KINDS
from ...harness.study import at_most
from .scores import ALL, UNSCALED, Line

TRIVIAL = CARRIED, SETTLED
"""Rivals without learning, of which no one gives derivatives: nothing may lose to them."""
BOUNDS: Mapping[str, float] = {
    ALL: 0.215,
    "materials": 0.216,
    "bones": 0.222,
    "palsy": 0.114,
    "several": 0.246,
    UNSCALED: 0.16,
}
"""Largest share of the network, on the corpus of `make study`: at most a quarter above what it measured there, and
below the share of each trivial rival. Kinds in which the network loses have no bound; `defeats` names them."""
ADDED = 0.95
"""Largest share of network + derivatives over that of the derivatives alone, to which the network adds.

Derivatives at rest know of no contact, which the corpus has, and the network has learned little of it.
"""


def make_gates(scores: Iterable[Line]) -> list[dict]:
    """Bound the network's share by kind, and that of network + derivatives over the derivatives'."""
    shares = find_shares(scores)
    kinds = {kind for _, kind in shares} | {ALL}
    both, derivatives = shares.get((NETWORK_AND_DERIVATIVES, ALL)), shares.get((DERIVATIVES, ALL))
    ratio = None if both is None or derivatives is None else both / derivatives
    return [
        *(
            at_most(f"network's share of |T - carried(S)|, {kind}", shares.get((NETWORK, kind)), bound)
            for kind, bound in BOUNDS.items()
            if kind in kinds
        ),
        at_most("share of network + derivatives over the derivatives'", ratio, ADDED),
    ]


def find_shares(scores: Iterable[Line]) -> dict[tuple[str, str], float]:
    """Find the share by method and kind."""
    return {(score["method"], score["kind"]): score["share"] for score in scores}


def describe_defeats(scores: Iterable[Line]) -> str:
    """Say on which kinds the network loses to a trivial rival; empty where it does not."""
    shares = find_shares(scores)
    lost = [
        f"{kind}: network {100 * shares[NETWORK, kind]:.1f} %, {rival} {100 * shares[rival, kind]:.1f} %"
        for kind in (ALL, *KINDS)
        for rival in TRIVIAL
        if kind != DEFAULT and (NETWORK, kind) in shares and (rival, kind) in shares
        and shares[rival, kind] <= shares[NETWORK, kind]
    ]  # fmt: skip
    return f"The network loses to a rival without learning on: {'; '.join(lost)}." if lost else ""
