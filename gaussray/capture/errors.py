"""What a reader of captures says when it cannot go on, and when it can."""


class CaptureError(ValueError):
    """The capture contradicts its format; the message names file, frame, key and remedy."""


class CaptureWarning(UserWarning):
    """The capture holds something that is not used, or lacks something that is assumed; named."""
