"""Shapes of analytic form, and the contacts of two of them."""
