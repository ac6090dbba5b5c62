"""Drawings of recordings: geometry of the selected environments over time, independent of the renderer."""
