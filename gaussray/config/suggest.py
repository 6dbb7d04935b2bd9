"""Suggests the word that the user probably meant instead of an unknown one."""

import difflib
from collections.abc import Iterable


# Similarity of two words (0 to 1, difflib's ratio) from which one is suggested for the other.
_SIMILAR = 0.6


def closest_word(word: str, candidates: Iterable[str]) -> str:
    """The candidate closest to a word.

    For `group.key`, a key of the same name in another group comes first, then a similar key of the
    same group, then any key.

    Args:
        word: the word that the user wrote.
        candidates: the known words.

    Returns:
        The closest one; empty if none is similar.
    """
    candidates = list(candidates)
    group, _, name = word.rpartition(".")
    same_group = [key for key in candidates if group and key.startswith(f"{group}.")]
    same_name = [key for key in candidates if key.rpartition(".")[2] == name]
    if len(same_name) == 1 and same_name[0] != word:
        return same_name[0]
    for group_words in (same_group, candidates):
        matches = difflib.get_close_matches(word, group_words, n=1, cutoff=_SIMILAR)
        if matches and matches[0] != word:
            return matches[0]
    return ""


def did_you_mean(word: str, candidates: Iterable[str]) -> str:
    """The question that ends a message, such as " Did you mean aperture.radius?".

    Args:
        word: the word that the user wrote.
        candidates: the known words.

    Returns:
        The question; empty if no candidate is similar.
    """
    suggestion = closest_word(word, candidates)
    return f" Did you mean {suggestion}?" if suggestion else ""
