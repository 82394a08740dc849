"""Print the lowest versions of the run-time dependencies that pyproject.toml states, as constraints for pip."""

import re
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
for stated in project["dependencies"]:
    if ">=" in stated:
        name, version = re.split(">=", stated)
        print(f"{name}=={version}")
