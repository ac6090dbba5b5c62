"""Pictures: what one ray meets, and the colour that it brings back. All in float32, lengths in units of the view."""
