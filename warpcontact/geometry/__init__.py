"""Tables for queries of meshes: BVH, face grid, contact clusters, clearance."""
