"""Where a fit starts: points on surfaces, and the motion of what moves."""
