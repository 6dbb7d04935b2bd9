"""What a YAML file of any program holds."""

from pathlib import Path
from typing import Any

import yaml

from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text
from gaussray.prepare.errors import PrepareError


def yaml_content(path: Path) -> Any:
    """What a YAML file holds.

    Raises:
        PrepareError: It is no YAML.
    """
    text = read_text(path).decode("utf-8-sig", "replace")
    try:
        check_aliases(path, text)
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PrepareError(
            f"{path}: must be YAML, got {str(error)[:200]}. Give the file as its program has "
            "written it."
        ) from None
