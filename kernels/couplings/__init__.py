"""Device code of couplings: force elements between two points, which need no search."""
