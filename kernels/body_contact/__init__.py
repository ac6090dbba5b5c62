"""Contact of bodies over an area: columns between the faces of two solids, their pressure and friction."""
