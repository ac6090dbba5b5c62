"""Nonsmooth contact measured: what is simulated, and how this engine and MuJoCo do it."""
