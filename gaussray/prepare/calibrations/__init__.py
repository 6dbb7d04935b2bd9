"""Readers of camera calibrations that other programs write."""
