"""One input that denoisers are known to fail on, for `bench/stability.py`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcdenoise_cl import Frame


@dataclass(frozen=True)
class Case:
    """An input that shows a failure.

    Attributes:
        topic: heading under which the table lists it, for instance "outliers".
        name: short, unique; also the name of its picture.
        tried: one sentence, what is tried.
        outcome: one sentence, what must come out.
        make: () -> (frame, truth, mask): truth (H, W, 3) or None where there is none; mask (H, W) bool, the pixels
            that are judged, or None for all.
        reference: () -> the truth with half buffers, where it is asked how much of the contrast on the judged pixels is
            kept; None where it is not.
    """

    topic: str
    name: str
    tried: str
    outcome: str
    make: Callable[[], tuple[Frame, np.ndarray | None, np.ndarray | None]]
    reference: Callable[[], Frame] | None = None
