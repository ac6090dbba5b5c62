"""Outcomes: scalars per environment, reduced from sensors over time during stepping."""
