"""Removes the parts of a fitted scene that its pictures do not need."""
