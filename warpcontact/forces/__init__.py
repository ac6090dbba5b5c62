"""Force elements, one folder per family."""
