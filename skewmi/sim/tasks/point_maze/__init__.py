"""PointMaze: a point that explores a maze of corridors."""
