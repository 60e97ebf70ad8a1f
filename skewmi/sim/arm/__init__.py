"""Everything generic about an arm with a scene in front of it."""
