"""Makes a package callable: `gaussray.render` is both a package and the function of its name."""

import importlib
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any


def callable_package(function: Callable[..., Any]) -> type[ModuleType]:
    """The class of a module that is called like a function.

    Python sets a subpackage as an attribute of its package, where a function of the same name would
    be lost; assigning a module's class is its documented way to change what a module does.
    """

    class CallablePackage(ModuleType):
        __signature__ = inspect.signature(function)
        __call__ = staticmethod(function)

        def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
            return importlib.import_module, (self.__name__,)

    return CallablePackage
