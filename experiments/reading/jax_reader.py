"""A produced data set in JAX: shuffled batches, the next of which a thread reads meanwhile.

`python -m experiments.reading.jax_reader DATA` prints the shapes of a batch.
"""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.capture.frames import read_image
from gaussray.dataset.sample_manifest import read_frames


def batches(data: Path | str, size: int, key: jax.Array) -> Iterator[dict[str, jax.Array]]:
    """One epoch of whole batches: linear light [size, h, w, 3], poses (camera to world, OpenGL
    axes) [size, 4, 4], times of all rows [size, h], and the samples' indices [size]."""
    data, frames = Path(data), list(read_frames(data))
    order = np.asarray(jax.random.permutation(key, len(frames)))
    parts = order[: len(order) // size * size].reshape(-1, size)

    def read(part: np.ndarray) -> dict[str, np.ndarray]:
        chosen = [frames[i] for i in part]
        light = [read_image(data / one["file_path"], one["w"], one["h"]) for one in chosen]
        times = [np.broadcast_to(np.float32(one["row_times"]), one["h"]) for one in chosen]
        return {
            "light": np.stack(light),
            "pose": np.stack([np.float32(one["transform_matrix"]) for one in chosen]),
            "row_times": np.stack(times),
            "sample": np.stack([one["take"]["index"] for one in chosen]),
        }

    with ThreadPoolExecutor(1) as pool:
        coming = [pool.submit(read, part) for part in parts[:1]]
        for part in [*parts[1:], None]:
            ready = coming.pop().result()
            if part is not None:
                coming.append(pool.submit(read, part))
            yield jax.tree.map(jnp.asarray, ready)


def main() -> None:
    batch = next(batches(sys.argv[1], 8, jax.random.key(0)))
    print({name: value.shape for name, value in batch.items()})


if __name__ == "__main__":
    main()
