"""Checks of user input, and safe text for messages."""
