"""Refuses YAML whose aliases expand to more values than memory holds ("billion laughs")."""

import math

import yaml


# Largest number of values of a file with all aliases expanded; configurations have a hundredth.
MOST = 100_000


def check_aliases(where: object, text: str) -> None:
    """Check the size of a YAML text with its aliases expanded.

    Args:
        where: what the error message names, such as a file.
        text: the YAML text.

    Raises:
        ValueError: the text has more than `MOST` values, or an alias contains itself.
        yaml.YAMLError: the text is not YAML.
    """
    if "*" not in text:
        return
    count, sizes = 0, dict[str, float]()
    # Anchor and number of values before it, of each collection that is open.
    begun: list[tuple[str | None, float]] = []
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        match event:
            case yaml.AliasEvent():
                # An alias of an open collection contains itself.
                inside = any(name == event.anchor for name, _ in begun)
                count += math.inf if inside else sizes.get(event.anchor, 1)
            case yaml.ScalarEvent():
                count += 1
                sizes[event.anchor] = 1
            case yaml.CollectionStartEvent():
                begun.append((event.anchor, count))
                count += 1
            case yaml.CollectionEndEvent():
                name, before = begun.pop()
                sizes[name or ""] = count - before
        if count > MOST:
            raise ValueError(
                f"{where}: must hold at most {MOST} values, those that aliases (*name) repeat "
                "included. Write the values without aliases."
            )
