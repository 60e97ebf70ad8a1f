"""Recordings of the very messages: written beside the hot loops, read back."""
