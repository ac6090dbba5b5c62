"""Broad phase: contact detection with cached clearances."""
