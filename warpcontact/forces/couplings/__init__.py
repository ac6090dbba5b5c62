"""Couplings: force elements between two points of bodies or of the world."""
