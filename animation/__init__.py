"""Heads that are drawn and move: pictures, the 3D page, takes played by simulator or rig, files and previews."""
