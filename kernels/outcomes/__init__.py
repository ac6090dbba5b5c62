"""Outcomes: what is kept of sensors over time, in a few numbers per environment, while it is stepped."""
