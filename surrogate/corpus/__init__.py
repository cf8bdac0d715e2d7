"""Training corpora: what a frame is, plan, generate, read (SoftDECA 3.4)."""
