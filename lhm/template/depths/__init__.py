"""The regressor D: how deep the skull wrap lies under a skin wrap (SoftDECA 3.1.2), from pairs or a prior."""
