"""Pictures: what a ray meets, and the colour that it brings back. In float32, lengths in units of the view."""
