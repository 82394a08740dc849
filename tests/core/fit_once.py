"""A model of generated heads, trained and fitted once: that an installation works, whatever fits."""

import numpy as np

from liaam.fitting import Fitter
from liaam.training import train
from scenes import Head, make_set

scenes = make_set(4, Head(7), size=(120, 90))
model = train([(scene.image, scene.landmarks) for scene in scenes[:3]], diagonal=50.0, leave_out=False, lamps=None)
result = Fitter(model).fit(scenes[3].image, scenes[3].landmarks)
assert result.status.ok, result.status
error = np.linalg.norm(result.landmarks - scenes[3].landmarks, axis=1).mean()
assert error < 2.0, error
print(f"{result.status}, {error:.2f} px off")
