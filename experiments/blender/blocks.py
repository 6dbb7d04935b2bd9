"""Blocks of a paired capture for what Blender films."""

SENSOR_MM = 36.0


def row_times(height, frames, readout):
    """The shutter block of Blender's rolling shutter, in units of a clip of `frames` frames.

    Row i, from the top, sees frame F + readout ((i + 1) / height - 1/2): position CENTER, one
    instant per row.
    """
    clip = frames - 1
    return {
        "row_offset": readout * (1 / height - 0.5) / clip,
        "row_step": readout / height / clip,
        "exposure": 0.0,
        "direction": "top_to_bottom",
    }
