"""Acceptance of steps, quarantine and reset."""
