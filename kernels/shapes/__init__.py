"""Contact between analytic shapes: shape classes, pair algorithms and kernels."""
