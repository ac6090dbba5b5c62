"""Particle contact: neighbor lists, contact forces and history of many spheres and capsules."""
