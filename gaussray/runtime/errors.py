"""Errors that a user can act on, beside ValueError and OSError."""


class FitError(RuntimeError):
    """A fit came to no scene; the message says why and what to do."""
