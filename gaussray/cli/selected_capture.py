"""Opens the capture of a configuration, with the selection of its pictures."""

from typing import Any

from gaussray.config.compose import Configuration
from gaussray.config.options import as_type, field_value
from gaussray.config.yaml_files import to_plain


def selected_capture(path: str, node: Configuration, label: str, prefix: str = "") -> Any:
    """Open the capture at a path with the selection (frames, crop, scale, ...) of a configuration.

    Args:
        path: the folder or file of the capture.
        node: the part of the configuration that holds the selection.
        label: what stands before a key in messages.
        prefix: how the keys of `node` that hold the selection begin.
    """
    from gaussray.capture.open import open_capture
    from gaussray.capture.selection import Selection

    def value(name: str) -> Any:
        return to_plain(node[prefix + name])

    fields = Selection.__dataclass_fields__.items()
    selection = Selection(**{n: field_value(f, value(n), f"{label}{n}") for n, f in fields})
    format, background = (
        as_type(str, value(name), f"{label}{name}") for name in ("format", "background")
    )
    return open_capture(path, format, background, selection=selection)
