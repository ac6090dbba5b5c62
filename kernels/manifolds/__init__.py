"""Contact manifolds of two solids: at most four points with one normal per patch, for nonsmooth contact."""
