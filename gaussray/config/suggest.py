"""What was probably meant by a word that is not known."""

import difflib
from collections.abc import Iterable


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word nearest to this one, or nothing. Of `group.key`, a key of the same name in
    another group, or a similar one in the same group, is nearer than what merely looks alike."""
    known = list(known)
    group, _, name = word.rpartition(".")
    own = [key for key in known if group and key.startswith(f"{group}.")]
    alike = [key for key in known if key.rpartition(".")[2] == name]
    if len(alike) == 1 and alike[0] != word:
        return alike[0]
    for some in (own, known):
        found = difflib.get_close_matches(word, some, n=1, cutoff=0.6)
        if found and found[0] != word:
            return found[0]
    return ""


def meant(word: str, known: Iterable[str]) -> str:
    """A question that ends a message: " Did you mean aperture.radius?", or nothing."""
    found = nearest(word, known)
    return f" Did you mean {found}?" if found else ""
