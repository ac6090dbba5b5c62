"""What a user declares: bodies, surfaces, points, shapes, contacts, materials and couplings, validated."""
