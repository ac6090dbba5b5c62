"""Joints of bodies to the world, and prescribed motion."""
