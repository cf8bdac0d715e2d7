"""How far others' fitted skulls are from measured ones."""

SKULL_PLACES = (
    ("SoftDECA, section 4.1", 3.83, "SKULLS: CT skulls and skin scans of 43 people, each left out"),
    ("multilinear model (Achenbach et al. 2018)", 1.98, "SKULLS, as SoftDECA quotes it"),
)
"""Model, mean error [mm] of the fitted skull wrap's places over the whole head, data (SoftDECA, section 4.1)."""
