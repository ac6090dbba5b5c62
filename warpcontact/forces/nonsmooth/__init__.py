"""Nonsmooth contact: contact problems of a step, and their materials."""
