"""Elements that the user declares: bodies, surfaces, points, shapes, contacts, materials and couplings, validated."""
