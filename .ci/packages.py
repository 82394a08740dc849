"""Print packages that pyproject.toml states, for pip.

``python .ci/packages.py test docs``
    The run-time dependencies, and the packages of extras, if any. Installing them does not build liaam.
``python .ci/packages.py --lowest``
    The lowest versions of the run-time dependencies, as constraints.
"""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
if sys.argv[1:] == ["--lowest"]:
    stated = [re.split(">=", each) for each in project["dependencies"] if ">=" in each]
    print("\n".join(f"{name}=={version}" for name, version in stated))
else:
    extras = [project["optional-dependencies"][name] for name in sys.argv[1:]]
    print("\n".join(sum(extras, project["dependencies"])))
