"""Tables for mesh queries: BVH, face grids, contact clusters, side regions."""
