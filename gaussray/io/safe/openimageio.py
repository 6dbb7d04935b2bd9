"""OpenImageIO, for every module that reads or writes pictures."""

import atexit
import sys

import OpenImageIO as oiio  # noqa: F401  (for others)


def _forget() -> None:
    """Let the library's types go before the interpreter does.

    JAX knows the classes that are pytrees for ever, they their modules' names, and so OpenImageIO's
    types outlive the interpreter, which its binding reports in thirty lines after every command.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith("gaussray."):
            vars(module).pop("oiio", None)


atexit.register(_forget)
