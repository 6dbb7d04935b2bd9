"""Runs where only what computes is installed: empty modules for libraries that open files.

Imported first, on machines that lack them; whatever needs one of them after all fails by its name.
"""

import importlib.util
import sys
import types


FILES = {"OpenImageIO": (), "av": ("error",), "jaxopt": ()}

for name, parts in FILES.items():
    if importlib.util.find_spec(name) is None:
        module = sys.modules[name] = types.ModuleType(name)
        for part in parts:
            sys.modules[f"{name}.{part}"] = types.ModuleType(f"{name}.{part}")
            setattr(module, part, sys.modules[f"{name}.{part}"])
