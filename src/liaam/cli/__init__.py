"""The command line: thin. Everything it does is a call that Python users have too."""
