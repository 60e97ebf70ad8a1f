"""Grippers of a robot whose arm says nothing about them: none, a fixed one, one behind RWS."""
