"""From videos or folders of pictures to a capture: frames, synchronisation, poses, checks.

The package can be called: `gaussray.prepare(...)` is `prepare.pipeline.prepare_capture`.
"""

import sys

from gaussray.prepare.pipeline import prepare_capture as prepare_capture
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(prepare_capture)
