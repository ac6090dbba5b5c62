"""Contact of points and spheres with triangle meshes."""
