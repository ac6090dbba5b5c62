"""Reference solvers for nonsmooth contact of one environment: assembly, equilibrium, event-driven motion."""
