"""Benchmark scenes of nonsmooth contact, and their runs with this engine and with MuJoCo."""
