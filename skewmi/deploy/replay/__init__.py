"""Recordings as Rerun files."""
