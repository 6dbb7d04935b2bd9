"""Times of one camera, which is at one place at a time: each is later than the one before."""

from gaussray.capture.formats.json_keys import Keys


# No picture is later, in seconds: in single precision such times would be infinite.
LATEST = 1e30


def check_later(keys: Keys, key: str, time: float, before: float, whose: str) -> None:
    """Refuse a time that is not later than the one before, or too far from 0.

    Args:
        keys: the block that has the time, for the message.
        key: its name there.
        time: the time in seconds.
        before: the time before; minus infinity of the first.
        whose: what the message says of the time before.

    Raises:
        CaptureError: it is one of these, or no number.
    """
    # NaN is not smaller either.
    if not abs(time) <= LATEST:
        raise keys.error(key, f"at most {LATEST:g} seconds from 0")
    if time <= before:
        raise keys.error(key, f"later than {before:.17g}, {whose}")
