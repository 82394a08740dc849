"""A model of the heads that come with liaam, trained and fitted once: that an installation works, whatever fits."""

import numpy as np

from liaam.datasets import load_heads
from liaam.fitting import Fitter
from liaam.training import train

heads = load_heads()[0]
model = train(heads.select("head-[1-4]-*"), diagonal=50.0, leave_out=False, lamps=None, progress=False)
new = next(head for head in heads if head.name == "head-5-1")
result = Fitter(model).fit(new.read_image(), new.landmarks.points)
assert result.status.ok, result.status
error = np.linalg.norm(result.landmarks - new.landmarks.points, axis=1).mean()
assert error < 4.0, error
print(f"{result.status}, {error:.2f} px off")
