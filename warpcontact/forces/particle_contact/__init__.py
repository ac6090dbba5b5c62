"""Piles: many spheres and capsules that all touch each other."""
