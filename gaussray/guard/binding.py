"""OpenImageIO, and an end without its complaints."""

import atexit
import sys

import OpenImageIO as oiio


__all__ = ["let_go", "oiio"]


@atexit.register
def let_go() -> None:
    """Forget the library everywhere in this package, before the interpreter ends.

    JAX's registry of classes, which nothing empties, holds their modules, and through these the
    library. Its binding would tell of that in more than a hundred lines on stderr.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith("gaussray."):
            vars(module).pop("oiio", None)
