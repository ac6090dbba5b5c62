"""Contact couplings: repulsive pressure between surfaces within a range."""
