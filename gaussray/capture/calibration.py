"""The import path of `read_capture` in version 0.1; use
`gaussray.open_capture` instead."""

from gaussray.capture.formats.paired import read_capture as read_capture
