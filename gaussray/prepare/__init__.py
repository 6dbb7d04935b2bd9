"""From videos or folders of pictures to a capture: frames, synchronisation, poses, checks."""

from gaussray.prepare.pipeline import prepare_capture as prepare_capture
