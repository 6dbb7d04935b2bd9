"""Suggests the word that the user probably meant instead of an unknown one."""

import difflib
from collections.abc import Iterable


# Similarity of two words (0 to 1, difflib's ratio) from which one is suggested for the other.
_SIMILAR = 0.6


def closest_word(word: str, known: Iterable[str]) -> str:
    """The known word closest to this one, empty if none is similar. For `group.key`, a key of the
    same name in another group comes first, then a similar key of the same group, then any key."""
    known = list(known)
    group, _, name = word.rpartition(".")
    same_group = [key for key in known if group and key.startswith(f"{group}.")]
    same_name = [key for key in known if key.rpartition(".")[2] == name]
    if len(same_name) == 1 and same_name[0] != word:
        return same_name[0]
    for candidates in (same_group, known):
        matches = difflib.get_close_matches(word, candidates, n=1, cutoff=_SIMILAR)
        if matches and matches[0] != word:
            return matches[0]
    return ""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The question that ends a message, such as " Did you mean aperture.radius?"; empty if no known
    word is similar."""
    suggestion = closest_word(word, known)
    return f" Did you mean {suggestion}?" if suggestion else ""
