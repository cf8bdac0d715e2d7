"""SoftDECA's own surrogate: f_DG = z_t L(p, h) by deformation gradients (SoftDECA 3.5), kept to compare with."""

from .runtime import BoundHypernetwork, HypernetworkSurrogate

__all__ = ["BoundHypernetwork", "HypernetworkSurrogate"]
