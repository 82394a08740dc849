"""Make the documentation's figures: ``python docs/figures/make_figures.py``. Needs no data.

``demo.png`` is the figure that ``liaam demo`` writes, made by the same code.
"""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

from liaam.experiments.demo import run_demo

HERE = Path(__file__).parent


def main() -> None:
    """Write every figure beside this script."""
    with tempfile.TemporaryDirectory() as folder:
        run_demo(Path(folder))
        shutil.copyfile(Path(folder) / "figure.png", HERE / "demo.png")
    print(f"written to {HERE / 'demo.png'}")


if __name__ == "__main__":
    main()
