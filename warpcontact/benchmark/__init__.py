"""How fast this machine steps: the short form for a user, and the works that ``benchmarks/`` does as well."""
