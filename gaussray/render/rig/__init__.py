"""Builds the cameras of a render from options."""
