"""The errors a user can meet. Each message is one sentence: what was given, what was expected, what to do."""


class McdenoiseError(Exception):
    """Base of every error this package raises on purpose."""


class FrameError(McdenoiseError, ValueError):
    """The planes of a frame do not fit together, or have a shape or dtype that cannot be used."""


class ExrError(McdenoiseError, ValueError):
    """An EXR file cannot be read, written, or understood."""


class ParameterError(McdenoiseError, ValueError):
    """An unknown method or parameter, or a value out of its range."""


class DeviceError(McdenoiseError, RuntimeError):
    """No OpenCL device, an unknown device, or a kernel that does not build."""


class NoRoomError(DeviceError):
    """The device, or the memory that was allowed, has no room for what a method keeps."""


class BudgetError(NoRoomError):
    """It is what was allowed that has no room."""


class RenderError(McdenoiseError, RuntimeError):
    """A scene cannot be found or rendered."""


class FarmError(McdenoiseError, RuntimeError):
    """A Dask cluster cannot be used, or has no worker left that can."""
