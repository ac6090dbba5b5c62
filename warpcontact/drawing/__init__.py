"""A recording as it is looked at: what moves where, in the chosen environments."""
