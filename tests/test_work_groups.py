"""How work is cut into groups: the same for every frame, so that no frame size brings compilations of its own."""

from collections import defaultdict

import pytest
from small_frames import CASES, frame

from mcdenoise_cl import Denoiser, Frame
from mcdenoise_cl.device import SCHEDULE_VARIABLE, shape_for
from mcdenoise_cl.engine import Engine

#: Together, all that methods launch; parameters and planes are those of small_frames.py, whose tests build the same.
LARGE = ("auto", "guided-prefilter", "ssim-nlm", "nlm-tonemapped")


def groups_of(case, height, width, monkeypatch):
    """Sizes of work-groups, by kernel and macros, of a frame of this size."""
    found, kernel = defaultdict(set), Engine.kernel

    def watched(self, file, name, **defines):
        built = kernel(self, file, name, **defines)

        def launch(queue, size, local, *arguments):
            found[name, tuple(sorted(defines.items()))].add(local)
            return built(queue, size, local, *arguments)

        return launch

    planes = frame(height, width)
    kept = {name: planes[name] for name in ("color", *CASES[case].planes)}
    with monkeypatch.context() as patch:
        patch.setattr(Engine, "kernel", watched)
        Denoiser(height, width, method=CASES[case].method, **CASES[case].parameters)(Frame(**kept))
    return found


@pytest.mark.parametrize("case", LARGE)
def test_work_groups_are_the_same_for_every_frame(case, monkeypatch, can_be_right):
    can_be_right("tile")
    monkeypatch.setenv(SCHEDULE_VARIABLE, "tile")
    one, other = (groups_of(case, *size, monkeypatch) for size in ((13, 17), (31, 64)))
    assert len(one) >= 8 and one == other
    assert all(len(sizes) == 1 and None not in sizes for sizes in one.values())


def test_a_piece_of_a_row_is_no_more_than_the_device_takes(device):
    columns, rows = shape_for(device).plain
    assert 1 <= columns * rows <= device.max_work_group_size
