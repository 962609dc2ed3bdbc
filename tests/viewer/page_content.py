"""Readers of the content of pages and of the browser that shows them."""

from __future__ import annotations

import base64
import io
import json
import re

import numpy as np

from manip3d.viewer import _chromium


def content(text: str) -> dict:
    """Return the data that Python wrote into the page."""
    found = re.search(r'id="manip3d-page">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def screenshot(tab: _chromium.Tab) -> np.ndarray:
    """Return a screenshot of the browser, (H, W, 3)."""
    from PIL import Image

    tab.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
    data = base64.b64decode(tab.send("Page.captureScreenshot", format="png")["data"])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def reddish(image: np.ndarray) -> np.ndarray:
    """Return a mask of the red pixels."""
    return (image[..., 0] > image[..., 1] + 80) & (image[..., 0] > image[..., 2] + 80)
