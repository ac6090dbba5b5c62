"""Ray tracing of pictures, in float32; lengths in units of the view."""
