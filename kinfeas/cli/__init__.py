"""The command line: one `kinfeas` command."""
