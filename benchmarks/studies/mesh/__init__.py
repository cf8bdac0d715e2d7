"""Errors of the mesh: discretisation and locking."""
