"""The training pictures, what moves in them, and the tiles that steps draw."""
