"""Device code of the couplings: force elements between points of bodies and of the world."""
