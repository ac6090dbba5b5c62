"""Narrow phase: closest points on triangle meshes."""
