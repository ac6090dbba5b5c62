"""File access: atomic replacement, direct I/O, and safe access to run folders of others."""
