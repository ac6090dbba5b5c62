"""Contact forces, history and wrenches."""
