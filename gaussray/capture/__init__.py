"""Pictures and their cameras, read from folders of many formats."""

from gaussray.capture.capture import Capture as Capture, View as View
from gaussray.capture.formats.paired import read_capture as read_capture
from gaussray.capture.open import open_capture as open_capture
