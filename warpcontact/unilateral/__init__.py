"""Unilateral contact: static problems, equilibrium, and the hard contacts of time stepping."""
