"""YAML of strangers: what an alias names stands again wherever it does, so that a few lines of
aliases of aliases are more than any memory holds."""

import math

import yaml


# Values of a file with all that is repeated; no configuration has a hundredth.
MOST = 100_000


def check_aliases(where: object, text: str) -> None:
    """ValueError if a YAML text, its aliases written out, has more than `MOST` values.

    YAMLError for what is none.
    """
    if "*" not in text:
        return
    count, sizes = 0, dict[str, float]()
    begun: list[tuple[str | None, float]] = []
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        match event:
            case yaml.AliasEvent():
                # One of what has not ended yet goes round in a circle.
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
                f"{where}: must hold at most {MOST} values, what its aliases (*name) repeat among "
                "them. Write out what is meant."
            )
