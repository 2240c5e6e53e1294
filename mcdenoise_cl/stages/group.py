"""How the group schedule cuts an image for kernels that compare patches (kernels/group_patch.h)."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine

#: Bytes that a group fills at most: the 32 KiB that every device has (OpenCL 1.2, table 4.3), less RESERVED.
LOCAL_BYTES = 31 * 1024
#: Some runtimes keep a little local memory for themselves.
RESERVED = 1024


def patch_defines(engine: Engine, patch_radius: int, outputs: int) -> dict[str, int]:
    """The macros that group_patch.h needs.

    Args:
        outputs: pixels to a work-item, down a column: the more, the more of the patches' sums they share, for more
            registers and local memory. Halved as long as local memory is short.
    """
    while outputs > 1 and _buffers(engine, patch_radius, outputs) > _room(engine):
        outputs //= 2
    return {**engine.group_defines(), "PATCH_RADIUS": patch_radius, "OUTPUTS": outputs}


def copy_defines(engine: Engine, defines: dict[str, int], search_radius: int) -> dict[str, int]:
    """COPY_RADIUS where three planes of a tile and its surroundings fit as well; none where local memory is no faster.

    Args:
        defines: from `patch_defines`.
    """
    if engine.device.local_mem_type != cl.device_local_mem_type.LOCAL:
        return {}
    patch_radius, outputs = defines["PATCH_RADIUS"], defines["OUTPUTS"]
    copy = 3 * 4 * _points(engine, patch_radius + search_radius, outputs)
    fits = _buffers(engine, patch_radius, outputs) + copy <= _room(engine)
    return {"COPY_RADIUS": search_radius} if fits else {}


def items(height: int, width: int, defines: dict[str, int]) -> tuple[int, int]:
    """The work-items that cover an image; to be rounded up to whole groups."""
    return width, -(-height // defines["OUTPUTS"])


def _room(engine: Engine) -> int:
    return min(LOCAL_BYTES, engine.device.local_mem_size - RESERVED)


def _points(engine: Engine, border: int, outputs: int) -> int:
    columns, rows = engine.shape.group
    return (columns + 2 * border) * (rows * outputs + 2 * border)


def _buffers(engine: Engine, patch_radius: int, outputs: int) -> int:
    """Bytes of the two buffers of points."""
    return 2 * 4 * _points(engine, patch_radius, outputs)
