"""The model of the generated heads, for beginners.

It is trained when it is first needed, which takes about a second. A file of the model would be fifty times as large as
its pictures.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from liaam.model import AAM
from liaam.model.views import Reliability
from liaam.studio.pictures import Kept

CALIBRATION = Path(__file__).with_name("heads_calibration.json")
"""The calibration that training with ``leave_out`` measures, which takes most of its time. Made with the pictures."""

_MODEL: Kept[str, AAM] = Kept(1)


def model_of_heads() -> AAM:
    """Return the model; the first call trains it, and other threads wait for it."""
    return _MODEL.get("model", trained)


def trained(calibrate: bool = False) -> AAM:
    """Train the model; measure its calibration, or read it from :data:`CALIBRATION`."""
    from liaam.datasets import load_heads
    from liaam.fitting.methods import DEFAULT_METHOD, METHODS
    from liaam.training import train

    options = {"lamps": None, "methods": "all", "name": "generated heads", "progress": False}
    model = train(load_heads()[0], leave_out=calibrate, **options)
    if calibrate:
        return model
    known = json.loads(CALIBRATION.read_bytes())
    fields: dict[str, Any] = {name: np.array(v) if isinstance(v, list) else v for name, v in known.items()}
    return model.with_view(METHODS[DEFAULT_METHOD].view, reliability=Reliability(**fields))
