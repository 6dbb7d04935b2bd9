"""How much trembles in pictures of what stands still."""

import numpy as np
from jaxtyping import Bool, UInt8


class Flicker:
    """Sums over the pictures of each camera from which their flicker follows.

    The flicker of a film is the root mean square difference of its pictures from their mean over
    time, over pixels that never move, in sRGB codes of 255. The truth has one of its own, of noise
    and of light that changes a little; ours is as steady if it is no larger. Pictures may come in
    any order; a camera with a single one says nothing.
    """

    def __init__(self):
        # Number, sum and sum of squares of the pictures by part and camera, the truth's before
        # ours: exact in 32 bits for 66,000 pictures.
        self._films: dict[tuple[str, str], tuple[int, np.ndarray, np.ndarray]] = {}

    def add(
        self,
        part: str,
        camera: str,
        still: Bool[np.ndarray, "h w"],
        truth: UInt8[np.ndarray, "h w 3"],
        ours: UInt8[np.ndarray, "h w 3"],
    ) -> None:
        """One more picture of a camera, as codes; `still` is the same for all of them."""
        codes = np.stack([truth[still], ours[still]]).astype(np.uint32)
        frames, total, square = self._films.get((part, camera), (0, *np.zeros_like([codes, codes])))
        self._films[part, camera] = frames + 1, total + codes, square + codes * codes

    def figures(self, part: str | None = None) -> dict[str, float]:
        """`flicker` of ours and `flicker_truth`, of one part or of all; empty if nothing is known.

        Every camera counts by its pictures and pixels.
        """
        square, weight = np.zeros(2), 0
        for camera in dict.fromkeys(camera for _, camera in self._films):
            own = [
                film
                for (name, seen_by), film in self._films.items()
                if seen_by == camera and part in (None, name)
            ]
            frames = sum(film[0] for film in own)
            if frames > 1:
                total = np.stack([x for _, x, _ in own]).sum(axis=0, dtype=np.float64)
                squares = np.stack([x for _, _, x in own]).sum(axis=0, dtype=np.float64)
                square += np.sum(squares - total * total / frames, axis=(1, 2))
                weight += frames * total[0].size
        if not weight:
            return {}
        truth, ours = np.sqrt(np.maximum(square, 0) / weight)
        return {"flicker": round(float(ours), 4), "flicker_truth": round(float(truth), 4)}
