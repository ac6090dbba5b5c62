"""The public classes ``Scene`` and ``Model``: building, USD import, memory of a model and its simulation."""
