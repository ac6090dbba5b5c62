"""Base of laws, friction models, shapes and joints: parameters, names and errors."""
