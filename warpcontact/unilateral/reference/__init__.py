"""Rigid contact of one environment, on the host: its assembly, its equilibrium, its motion from event to event."""
