"""Imports OpenImageIO for all modules that read or write pictures."""

import atexit
import sys

import OpenImageIO as oiio  # noqa: F401  (for others)


def _forget() -> None:
    """Drop references to OpenImageIO before the interpreter ends.

    JAX keeps pytree classes forever, these keep the names in their modules, and so OpenImageIO's
    types outlive the interpreter; nanobind would then print thirty lines of warnings after every
    command.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith("gaussray."):
            vars(module).pop("oiio", None)


atexit.register(_forget)
