"""Commands that read what the studio has saved work without the packages of its server."""

import subprocess
import sys

CODE = """
import sys
for name in ("starlette", "uvicorn", "anyio", "h11"):
    sys.modules[name] = None  # as if it were not installed
import liaam.studio.origins, liaam.studio.template
"""


def test_saved_origins_and_templates_are_read_without_a_server():
    ran = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
