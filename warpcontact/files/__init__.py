"""Files: atomic replacement, direct I/O, and run folders of others."""
