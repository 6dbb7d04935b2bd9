"""Evaluation: scores of rendered pictures against the pictures of a capture."""

from gaussray.evaluate.pipeline import EvaluateOptions as EvaluateOptions, evaluate as evaluate
