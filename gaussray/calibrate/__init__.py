"""Cameras, estimated from pictures of a known scene."""

from gaussray.calibrate.pipeline import CalibrateOptions as CalibrateOptions, calibrate as calibrate
