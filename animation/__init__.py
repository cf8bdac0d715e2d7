"""A head that moves: takes in, simulated or by a rig, and out as animation files and previews."""
