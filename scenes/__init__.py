"""Simulated portraits: a parametric head, Planckian lights with cast shadows, and a camera.

>>> from scenes import Head, lateral, make_set, render
>>> training = make_set(2, head=Head(7))
>>> test = render(Head(7), lights=lateral("left"))

The image formation is that of Pizarro, Peyras and Bartoli (CVPR 2008), after Finlayson: a Lambertian surface, Planckian
light, and a sensor that is linear up to its response curve. Everything follows from the seeds.
"""

from scenes.camera import Camera, narrow_band_camera
from scenes.head import Expression, Head, Pose
from scenes.light import DIFFUSE, Ambient, Lights, PointLight, lateral
from scenes.plane import PlaneLight, colour_chart, even_light, photograph, poster, uneven_light
from scenes.render import Scene, make_set, random_expression, random_pose, render

Light = Lights

__all__ = [
    "DIFFUSE",
    "Ambient",
    "Camera",
    "Expression",
    "Head",
    "Light",
    "PlaneLight",
    "PointLight",
    "Pose",
    "Scene",
    "colour_chart",
    "even_light",
    "lateral",
    "make_set",
    "narrow_band_camera",
    "photograph",
    "poster",
    "random_expression",
    "random_pose",
    "render",
    "uneven_light",
]
