"""Vectors and poses on the host."""
