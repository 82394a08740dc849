"""``python -m liaam`` is the command ``liaam``."""

from liaam.cli import main

main()
