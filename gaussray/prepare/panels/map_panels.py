"""Panels that are maps (depth, masks, labels) beside panels that are pictures, by their colours."""

import numpy as np
from jaxtyping import UInt8

from gaussray.prepare.panels.layout import PanelLayout


# A pixel is coloured if its channels differ by more than the first, or certainly the second number
# of levels; compression leaves a few. A panel is grey if at most such a share of its pixels is
# coloured, and coloured if such a share certainly is: of simulated scenes of grey things 0.006.
_COLOURED, _SURELY = 16, 24
_GREY_SHARE, _COLOURED_SHARE = 0.001, 0.004
# Masks of labels: of 4 bits a channel, so few colours are of so large a share of the pixels. In
# pictures of simulated scenes it is 0.9.
_FEW, _MOST = 8, 0.98
# Next to a cut, compression mixes the colours of both sides.
_BORDER = 8


def picture_panels(picture: UInt8[np.ndarray, "h w 3"], layout: PanelLayout) -> tuple[int, ...]:
    """The indices of the panels that are pictures where the others are maps: grey or of a few
    colours. All of them where colours do not tell such a difference.

    Args:
        picture: levels.
        layout: arrangement of panels.
    """
    kinds = [_kind(panel) for panel in layout.panels(picture)]
    everyone = tuple(range(len(kinds)))
    if "unclear" in kinds:
        return everyone
    return tuple(k for k in everyone if kinds[k] == "picture") or everyone


def _kind(panel: UInt8[np.ndarray, "h w 3"]) -> str:
    """One of map, picture (coloured) and unclear."""
    inner = panel[_BORDER:-_BORDER, _BORDER:-_BORDER]
    if not inner.size:
        return "unclear"
    chroma = inner.max(axis=2) - inner.min(axis=2)
    if (chroma > _COLOURED).mean() <= _GREY_SHARE:
        return "map"
    if (chroma > _SURELY).mean() < _COLOURED_SHARE:
        return "unclear"
    r, g, b = (inner[..., k].astype(np.int32) >> 4 for k in range(3))
    counts = np.sort(np.bincount((r << 8 | g << 4 | b).ravel()))
    return "map" if counts[-_FEW:].sum() >= _MOST * chroma.size else "picture"
