"""Data and results of the R package geomorph 4.0.8, which lie beside the project (``../shared/data/geomorph``)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

MATCHING = ("matching", "mosquito")
OBJECT = ("object", "lizards")


@dataclass(frozen=True)
class Printed:
    """An analysis of variance as geomorph prints it: text of each number, by effect and column."""

    cells: Mapping[str, Mapping[str, str]]

    @classmethod
    def read(cls, path: Path, trait: str) -> "Printed":
        """Read the table of shape, or of centroid size, whose columns may be wrapped to a second part."""
        text = path.read_text().split("centroid size\n")
        columns: list[str] = []
        cells: dict[str, dict[str, str]] = {}
        for line in text[trait == "centroid size"].splitlines():
            words = line.split()
            effect = words[0] if words else ""
            if re.match(r" +\S", line) and words:
                columns = [word for word in words if word != "Pr(>F)"]
            elif effect in ("ind", "side", "ind:side", "ind:side:replicate", "Total") and columns:
                of_effect = cells.setdefault(effect, {})
                of_effect.update(zip(columns, words[1:], strict=False))
        return cls(cells)


def read_set(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Read landmarks (n, 2, r, k, 2), or (n, r, k, 2) for object symmetry, and twins (k,); left ones are reflected."""
    table = pd.read_csv(folder / f"{name}.csv")
    factors = [column for column in ("ind", "side", "replicate") if column in table]
    counts = [len(table[factor].unique()) for factor in factors]
    table["ind"] = pd.factorize(table["ind"])[0]
    table = table.sort_values([*factors, "landmark"], kind="stable")
    shapes = table[["x", "y"]].to_numpy().reshape(*counts, -1, 2)
    if name == "matching":
        shapes[:, 0, :, :, 0] *= -1
    twins = np.arange(shapes.shape[-2])
    if name in OBJECT:
        for first, second in pd.read_csv(folder / f"{name}-pairs.csv").to_numpy() - 1:
            twins[first] = second
            twins[second] = first
    return shapes, twins


def read_shapes(path: Path) -> np.ndarray:
    """Read shapes (m, k, 2), a row each."""
    values = pd.read_csv(path).to_numpy()
    return values.reshape(len(values), -1, 2)
