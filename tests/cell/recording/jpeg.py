"""A small colour image."""

import io

from PIL import Image

_FILE = io.BytesIO()
Image.linear_gradient("L").convert("RGB").resize((64, 40)).save(_FILE, "JPEG")
JPEG = _FILE.getvalue()
"""JPEG of 64x40 pixels."""
