"""The error of videos or pictures from which no capture can be made."""


class PrepareError(ValueError):
    """No capture can be made of the input; the message says why and what to do about it."""
