"""Aliases of YAML are counted as often as what they name stands there."""

import time

import pytest
import yaml

from gaussray.io.safe import aliases
from gaussray.io.safe.aliases import check_aliases


def laughs(levels):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    names = (", ".join(9 * [f"*a{i}"]) for i in range(levels))
    return "\n".join([*lines, *(f"a{i + 1}: &a{i + 1} [{name}]" for i, name in enumerate(names))])


def values(node):
    """All nodes below one, itself among them."""
    if isinstance(node, dict):
        return 1 + sum(1 + values(x) for x in node.values())
    return 1 + sum(map(values, node)) if isinstance(node, list) else 1


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [1, {b: 2}]\nc: [*a, *a]",
        "a: &a 3\nb: *a",
        "a: &a {x: 1}\nb: [*a, &b 2, *b, *a]",
        laughs(2),
    ],
)
def test_values_are_counted_as_they_are_written_out(monkeypatch, text):
    count = values(yaml.safe_load(text))
    monkeypatch.setattr(aliases, "MOST", count)
    check_aliases("a.yaml", text)
    monkeypatch.setattr(aliases, "MOST", count - 1)
    with pytest.raises(ValueError, match="a.yaml: must hold at most"):
        check_aliases("a.yaml", text)


@pytest.mark.parametrize("text", [laughs(40), "a: &a [*a]", "a: &a {b: {c: *a}}"])
def test_more_than_memory_holds_is_refused_at_once(text):
    begin = time.perf_counter()
    with pytest.raises(ValueError, match="a.yaml: must hold at most 100000 values"):
        check_aliases("a.yaml", text)
    assert time.perf_counter() - begin < 5


def test_a_star_that_is_no_alias_is_fine_and_what_is_no_yaml_is_said():
    check_aliases("a.yaml", "a: 'x * y'\nb: '*'")
    check_aliases("a.yaml", "a: *unknown")
    with pytest.raises(yaml.YAMLError):
        check_aliases("a.yaml", "a: [*")
