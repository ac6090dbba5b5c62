"""Analytic shapes, and contact of two shapes."""
