"""``python -m liaam`` is the command ``liaam``."""

from liaam.cli.main import main

main()
