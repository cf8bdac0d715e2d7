"""Skin, muscle and skull wrap: one triangulation, shrunk onto the skin and grown inward without crossings."""
