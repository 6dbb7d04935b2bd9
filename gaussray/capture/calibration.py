"""The import path of `read_capture` in version 0.1; new code imports it from `gaussray.capture`."""

from gaussray.capture.formats.paired import read_capture as read_capture
