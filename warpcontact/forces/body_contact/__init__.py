"""Force elements of body contact: contact of solids over an area."""
