"""Evaluation: scores of rendered pictures against the pictures of a capture.

The package can be called: `gaussray.evaluate(...)` is `evaluate.pipeline.evaluate`.
"""

import sys

from gaussray.evaluate.options import EvaluateOptions as EvaluateOptions
from gaussray.evaluate.pipeline import evaluate as evaluate
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(evaluate)
