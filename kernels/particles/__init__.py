"""Contact among many spheres and capsules of an environment: who is near whom, and what touches do."""
