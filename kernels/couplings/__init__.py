"""Device code of couplings: force elements between two points, without contact detection."""
