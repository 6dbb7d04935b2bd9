"""Pictures of a scene, scored against the pictures of a capture."""

from gaussray.evaluate.pipeline import EvaluateOptions as EvaluateOptions, evaluate as evaluate
