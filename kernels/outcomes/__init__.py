"""Outcomes: what is kept of readings over time, in a few numbers per environment, while it is stepped."""
