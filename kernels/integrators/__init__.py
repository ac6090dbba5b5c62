"""Time integration and acceptance of steps."""
