"""Make the picture of the guide to trays: ``python -m docs.figures.make_tray``. Needs no data, and zxing-cpp.

The leaves, their labels and the ruler are generated. The script also prints what the commands of the guide print, and
how far the lengths are from the true ones, in standard errors.
"""

import csv
import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from liaam.__main__ import main
from liaam.io import Landmarks, read_image, write_image, write_landmarks
from scenes.tray import NAMES, draw_leaf_on_paper, draw_tray, random_leaf

HERE = Path(__file__).parent

N_TRAINING = 24
N_TRAYS = 20
PERIOD = 8.0  # pixels of a millimetre
GREEN = (64, 255, 140)
RED = (200, 30, 30)
FONT = (cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)  # font, size and thickness of names
GAP = 9  # pixels between a name and the leaf below it, or the border of the picture


def run(*arguments: str) -> None:
    """Run a command of liaam, and print it."""
    print("$ liaam", *arguments, flush=True)
    sys.argv = ["liaam", *arguments]
    try:
        main()
    except SystemExit as stopped:
        if stopped.code:
            print(f"(status {stopped.code})")


def make() -> None:
    """Walk through the guide, and draw its picture."""
    rng = np.random.default_rng(66)
    Path("leaves").mkdir()
    for i in range(N_TRAINING):
        one = draw_leaf_on_paper(random_leaf(rng), rng)
        write_image(f"leaves/leaf{i}.png", one.image)
        write_landmarks(f"leaves/leaf{i}.csv", Landmarks(one.landmarks[0], names=NAMES))
    Path("trays").mkdir()
    truth = {}
    for i in range(N_TRAYS):
        texts = [f"HB-{6 * i + k:03}" for k in range(1, 7)]
        tray = draw_tray([random_leaf(rng) for _ in texts], rng, texts=texts, ruler=PERIOD)
        write_image(f"trays/tray{i + 1}.png", tray.image)
        for text, marks in zip(texts, tray.landmarks, strict=True):
            truth[text] = float(np.linalg.norm(marks[0] - marks[1])) / PERIOD
    trays = [f"trays/tray{i + 1}.png" for i in range(N_TRAYS)]
    run("train", "leaves", "-o", "leaf.liaam")
    run("fit", "leaf.liaam", *trays, "--all", "--name-by", "code", "--crops", "-o", "fits")
    run("scale", *trays, "--ruler", "1 mm", "-o", "scales.csv")
    run("measure", "fits", "distance:base,tip", "--scale", "scales.csv", "-o", "table.csv")
    report(truth)
    draw()


def report(truth: dict[str, float]) -> None:
    """Print how far lengths are from the true ones, in standard errors."""
    with Path("table.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["distance_base_tip_mm"]]
    named = [row for row in rows if row["specimen"] in truth]
    errors = [
        (float(row["distance_base_tip_mm"]) - truth[row["specimen"]]) / float(row["distance_base_tip_mm_se"])
        for row in named
    ]
    within = float(np.mean(np.abs(errors) < 1.96))
    print(f"{len(named)} of {len(truth)} leaves named and measured; {100 * within:.1f} % within 1.96 standard errors")
    print(f"root mean square of errors in standard errors: {np.sqrt(np.mean(np.square(errors))):.2f}")


def draw() -> None:
    """Draw the first tray with the landmarks and the names that were found."""
    import json

    picture = read_image("trays/tray1.png").copy()
    for path in sorted(Path("fits").glob("tray1_*.json")):
        facts = json.loads(path.read_text())
        points = np.array(facts["landmarks"])
        if facts["status"] != "converged":
            continue
        for x, y in np.rint(points * 16).astype(int).tolist():
            cv2.circle(picture, (x, y), 45, (0, 0, 0), -1, cv2.LINE_AA, 4)
            cv2.circle(picture, (x, y), 32, GREEN, -1, cv2.LINE_AA, 4)
        write_above(picture, facts["specimen"], points)
    cv2.imwrite(str(HERE / "tray.jpg"), picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


def write_above(picture: np.ndarray, name: str, points: np.ndarray) -> None:
    """Write a name above the points (n, 2) of a leaf, inside the picture."""
    (width, height), _ = cv2.getTextSize(name, *FONT)
    x = points[:, 0].mean() - width / 2
    y = points[:, 1].min() - GAP
    x = np.clip(x, GAP, picture.shape[1] - width - GAP)
    y = max(y, height + GAP)
    font, size, thickness = FONT
    cv2.putText(picture, name, (round(x), round(y)), font, size, RED, thickness, cv2.LINE_AA)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        make()
        os.chdir(HERE)
