"""Compare lamps of rendered heads with real ones: ``python -m making.head.compare HEADS LAMPS -o OUT``.

HEADS is ``ict-face.safetensors``. LAMPS is a folder of persons under flashes, as for ``liaam lamps``. For each real
lamp, the flash, or the room without a flash, is chosen whose field on the mean rendered head resembles the real ones
most. OUT receives ``fields.csv``, with the correlation of that field with each person's within the mesh, and of the
mean of the other persons' with it, and ``fields.png``, where the fields are side by side.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import liaam
from liaam.datasets import Sample
from liaam.io import Landmarks, write_image
from liaam.model.light_basis import SIDE, in_field
from liaam.training import LearntLamps, learn_lamps
from liaam.training.lamps.bank import carried
from making.head.casting import sitter
from making.head.geometry import ScannedHeads, load_heads
from making.head.light import Lamp, Light, Room
from making.head.photographs import face_in

N_HEADS = 6
"""Number of rendered heads, whose fields are averaged."""

SIZE = 160
"""Side of the rendered pictures, pixels."""

LOOKS = {"skin": (0.45, 0.30, 0.23), "beard": 0.0}
"""Reflectance of the heads' skin in red, green and blue, and density of their beards, as of the real persons.

These have fair skin and are shaved. Darker skin is exposed for longer, so that its gloss counts for more, and a beard
hides the shading."""

AZIMUTHS = (-75, -60, -45, -30, -15, 0, 15, 30, 45, 60, 75)
ELEVATIONS = (-15, 0, 15, 25, 35, 40)
"""Directions of flashes that are tried, degrees."""

DISTANCE = 170.0
"""Distance of the flashes from the face, cm."""

FILL = Room(0.4, (0.0, 0.7, 0.0))
"""Light of the room, most of it from above, when a flash of strength 1 goes off."""

ROOMS = ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.7, -0.7), (0.0, 1.0, -0.4), (0.0, 1.0, 0.2), (0.0, 0.7, 0.7))
"""Directions from which light may come without a flash."""

WITHOUT_FLASH = np.log(0.08)
"""Logarithm of how bright a face is without a flash, relative to one with it. Correlations hardly depend on it."""

SEED = 3
"""Seed of the heads."""

WHITE = 3.0
"""Standard deviations above the mean of a field that become white, and below it that become black."""


@dataclass(frozen=True)
class Candidate:
    """A light that a real lamp may be.

    Attributes
    ----------
    name : str
        What it is, for tables.
    light : Light
    adaption : float
        Logarithm of the brightness of the face, relative to the training light.
    """

    name: str
    light: Light
    adaption: float = 0.0


@dataclass(frozen=True, eq=False)
class Match:
    """The candidate that resembles a real lamp most.

    Attributes
    ----------
    lamp, candidate : str
        Names.
    correlation, left_out : float
        Mean correlation of the persons' fields with the candidate's, and with the mean of the other persons'.
    field : (side, side) float32
        The candidate's.
    """

    lamp: str
    candidate: str
    correlation: float
    left_out: float
    field: np.ndarray


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("heads", type=Path, help="ict-face.safetensors")
    parser.add_argument("lamps", type=Path, help="folder of persons under flashes")
    parser.add_argument("--training-lamp", required=True, help="name of the flash from the front")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    given = parser.parse_args()
    real = learn_lamps(liaam.load_folder(given.lamps), given.training_lamp)
    by_lamp = brightness_by_lamp(real)
    inside = face_in((SIDE, SIDE), in_field(real.mean))
    choices = candidates()
    fields = rendered_fields(load_heads(given.heads), choices, real.mean)
    matches = [best_match(lamp, persons, choices, fields, inside) for lamp, persons in by_lamp.items()]
    header = ("lamp", "resembles most", "correlation", "of a person left out", "ratio")
    rows = []
    for match in matches:
        numbers = (match.correlation, match.left_out, match.correlation / match.left_out)
        rows.append((match.lamp, match.candidate, *(f"{number:.3f}" for number in numbers)))
    given.output.mkdir(parents=True, exist_ok=True)
    with (given.output / "fields.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    write_image(given.output / "fields.png", side_by_side(matches, by_lamp, inside))
    for row in (header, *rows):
        print("  ".join(text.ljust(24) for text in row))


def candidates() -> list[Candidate]:
    """Return flashes from all directions in the room, and the room alone."""
    flashes = [
        Candidate(f"flash at {azimuth}°, {elevation}° up", Light((flash(azimuth, elevation),), FILL))
        for azimuth in AZIMUTHS
        for elevation in ELEVATIONS
    ]
    rooms = [Candidate(f"room, axis {axis}", Light((), Room(1.0, axis)), WITHOUT_FLASH) for axis in ROOMS]
    return flashes + rooms


def flash(azimuth: float, elevation: float) -> Lamp:
    """Return a flash at angles in degrees."""
    return Lamp(np.deg2rad(azimuth), np.deg2rad(elevation), DISTANCE)


def rendered_fields(heads: ScannedHeads, choices: Sequence[Candidate], mean: np.ndarray) -> np.ndarray:
    """Return the brightness of the candidates' fields, means over some heads, (k, side, side) float32.

    They are on the mean shape (n, 2) of the real lamps.
    """
    lamps = learn_lamps(photographs(heads, choices), "front")
    fields = carried(lamps.mean, lamps.fields, mean).astype(np.float32).mean(axis=3)
    return fields.reshape(N_HEADS, len(choices), SIDE, SIDE).mean(axis=0)


def photographs(heads: ScannedHeads, choices: Sequence[Candidate]) -> Iterator[Sample]:
    """Yield each head under the flash from the front and under the candidates."""
    front = Light((flash(0.0, 0.0),), FILL)
    for i in range(N_HEADS):
        rng = np.random.default_rng([SEED, i])
        person = sitter(heads, rng, SIZE, LOOKS)
        landmarks = Landmarks(person.points)
        yield Sample(f"{i}-front", person.photographed(front, 0.0, rng), landmarks)
        for k, choice in enumerate(choices):
            yield Sample(f"{i}-{k}", person.photographed(choice.light, choice.adaption, rng), landmarks)


def brightness_by_lamp(real: LearntLamps) -> dict[str, np.ndarray]:
    """Return the brightness of the fields of each lamp's persons, (p, side, side) float32."""
    brightness = real.fields.astype(np.float32).mean(axis=3)
    names = np.array([name.rpartition("-")[2] for name in real.names])
    return {str(name): brightness[names == name] for name in np.unique(names)}


def best_match(
    lamp: str, persons: np.ndarray, choices: Sequence[Candidate], fields: np.ndarray, inside: np.ndarray
) -> Match:
    """Return the candidate whose field resembles those of persons (p, side, side) under a lamp most."""
    correlations = [np.mean([correlation(person, field, inside) for person in persons]) for field in fields]
    best = int(np.argmax(correlations))
    return Match(lamp, choices[best].name, float(correlations[best]), left_out(persons, inside), fields[best])


def left_out(persons: np.ndarray, inside: np.ndarray) -> float:
    """Return the mean correlation of persons' fields (p, side, side) with the mean of the others'."""
    total = persons.sum(axis=0)
    return float(np.mean([correlation(person, total - person, inside) for person in persons]))


def correlation(one: np.ndarray, other: np.ndarray, inside: np.ndarray) -> float:
    """Return the correlation of two fields (side, side) within the mesh."""
    return float(np.corrcoef(one[inside], other[inside])[0, 1])


def side_by_side(matches: Sequence[Match], by_lamp: dict[str, np.ndarray], inside: np.ndarray) -> np.ndarray:
    """Return a picture with a column for each lamp: the persons' mean, the rendered field, and the first person."""
    columns = []
    for match in matches:
        persons = by_lamp[match.lamp]
        column = (persons.mean(axis=0), match.field, persons[0])
        columns.append(np.concatenate([grey(field, inside) for field in column]))
    picture = cv2.resize(np.concatenate(columns, axis=1), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    return picture[..., None].repeat(3, axis=2)


def grey(field: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return a field (side, side) as uint8, whose mean within the mesh is grey."""
    deviations = (field - field[inside].mean()) / field[inside].std()
    return np.rint(255.0 * np.clip(deviations / (2 * WHITE) + 0.5, 0.0, 1.0)).astype(np.uint8)


if __name__ == "__main__":
    main()
