"""Nodes and their numbers, and how ranks share a mesh."""
