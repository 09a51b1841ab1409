"""The command line: options of a command, a call of `api`, and the printed answer."""
