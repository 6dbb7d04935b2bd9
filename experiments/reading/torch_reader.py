"""A produced data set in PyTorch: pictures with the exact camera and row times of each.

`python -m experiments.reading.torch_reader DATA` prints the shapes of a batch.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from gaussray.capture.frames import read_image
from gaussray.dataset.takes import read_frames


class Frames(Dataset):
    """Linear light [3, h, w], pose (camera to world, OpenGL axes), and the time of every row."""

    def __init__(self, data: Path | str):
        self.data, self.frames = Path(data), list(read_frames(data))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, i: int) -> dict[str, torch.Tensor]:
        frame = self.frames[i]
        light = read_image(self.data / frame["file_path"], frame["w"], frame["h"])
        times = np.broadcast_to(np.float32(frame["row_times"]), frame["h"]).copy()
        return {
            "light": torch.from_numpy(light).permute(2, 0, 1).contiguous(),
            "pose": torch.tensor(frame["transform_matrix"], dtype=torch.float32),
            "row_times": torch.from_numpy(times),
            "take": torch.tensor(frame["take"]["index"]),
        }


def main() -> None:
    batch = next(iter(DataLoader(Frames(sys.argv[1]), batch_size=8, shuffle=True)))
    print({name: tuple(value.shape) for name, value in batch.items()})


if __name__ == "__main__":
    main()
