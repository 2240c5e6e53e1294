"""Pictures of the maps."""

import inputs
import numpy as np
import pytest

from mcdenoise_cl import Frame, ParameterError, denoise
from mcdenoise_cl.maps import PALETTE, error_picture, map_sheet, model_picture


def test_model_picture():
    rng = np.random.default_rng(0)
    models = rng.integers(0, 4, (13, 17)).astype(np.uint8)
    picture = model_picture(models)
    assert picture.shape == (13, 17, 3) and picture.dtype == np.uint8
    for model, color in enumerate(PALETTE):
        np.testing.assert_array_equal((picture == color).all(-1), models == model)
    gray = PALETTE.astype(float) @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(gray) > 30).all(), "told apart by brightness alone"


def test_error_picture():
    picture = error_picture(np.array([[0.0, 1e-4, 1e-3, 1e-2, 1.0, 7.0]]))
    np.testing.assert_allclose(picture[0, :, 0], [0, 0, 255 / 4, 255 / 2, 255, 255], atol=0.6)


def test_map_sheet():
    frame = Frame(**inputs.features(40, 64))
    sheet = map_sheet(denoise(frame, details=True))
    assert sheet.dtype == np.uint8 and sheet.shape[1] > 2 * 64 and sheet.shape[0] > 40
    with pytest.raises(ParameterError, match="method nlm has no maps"):
        map_sheet(denoise(frame, method="nlm", details=True))
