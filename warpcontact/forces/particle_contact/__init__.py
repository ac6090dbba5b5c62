"""Particle contact: contact between all pairs of many spheres and capsules."""
